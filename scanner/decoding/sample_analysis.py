"""Observe a capture from a sample of its pixels before full decoding: noise, ambient light, motion, frame checks."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Bools, Floats32, Image, Ints
from scanner.decoding.codes.code_checks import check_codes
from scanner.decoding.coordinates.axis_decoder import AxisDecoder, FringeAxis
from scanner.decoding.coordinates.code_images import CodeImages, signals_of
from scanner.decoding.coordinates.decoder_calibration import (
    calibrated_decoders,
    drop_lost_fringes,
    measured_widely,
    modulation,
    resolve_bits,
)
from scanner.decoding.corrections import CorrectedFrames
from scanner.decoding.corrections.gains import FrameGains, fit_bits, gains_of_pairs, with_white_as_in_patterns
from scanner.decoding.fringes.single_fringe import Unchecked
from scanner.decoding.light.constraints import NoiseModel, measure_noise
from scanner.decoding.light.exposures import lit_by, log_mosaic, saturation_level
from scanner.decoding.light.frame_checks import agree, check_frames, is_explained_by_swap, suspected
from scanner.decoding.light.samples import Sample, Samples
from scanner.decoding.map_checks import annotate_errors, check_fringes
from scanner.decoding.motion import (
    CodeShift,
    DetectedMotion,
    InconsistentPixels,
    MotionEstimate,
    ObservedFringes,
    attribute_to_shifts,
    find_inconsistent_pixels,
    find_phase_jump,
    measure_motion,
    shifts_of_codes,
)
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS
from scanner.errors import InputError

BRIGHTER_WHITE = FindingKind(
    "brighter-white",
    "White is brighter in the patterns than in the white frame; it was taken into account.",
    "Switch off what makes the projector's or the camera's brightness depend on the picture.",
    ("brightness_ratio",),
)
RAW_COLOURS = FindingKind(
    "raw-colours",
    "The frames are raw ones of a colour camera, pixel by pixel behind filters; they are taken as grey.",
    "Use a monochrome camera, or let the driver deliver grey or colour frames.",
)


@dataclass(frozen=True)
class Observations:
    """Properties of the capture that do not depend on the pattern code: noise, light and motion."""

    levels: Image
    """(frames, P): the sample's grey levels as taken."""
    noise: NoiseModel
    """Of a pixel of the corrected frames."""
    saturation: float
    """The lowest clipped grey level."""
    flicker: float | None
    """As in `Decoding`."""
    measuring_motion: Future[MotionEstimate | None]
    """The motion of the devices, measured in the background."""
    code_shifts: tuple[CodeShift, ...]
    """Of the codes of each axis against its fringes."""
    findings: tuple[Finding, ...]
    """For the operator."""
    phase_jump: Callable[[], DetectedMotion | None]
    """Finds, on request, a bump by which fringes jumped."""
    inconsistent: InconsistentPixels | None = None
    """Where an object moved, if the frames agree elsewhere; None otherwise."""

    @property
    def moved(self) -> Bools | None:
        """(H, W): True where something moved; None if nothing did."""
        return None if self.inconsistent is None else self.inconsistent.moved

    @property
    def motion(self) -> MotionEstimate | None:
        """The motion of the devices; waits for its measurement to finish."""
        return self.measuring_motion.result()


def observe(
    frames: CorrectedFrames, samples: Samples, log_exposure: Floats32 | None, projector_size: tuple[int, int]
) -> tuple[CodeImages, Samples, Observations]:
    """Return the folded frames and the samples, of frames that are equally bright, without unresolved fringes and bits;
    and what samples tell.

    `log_exposure` (H, W): as in `CodeImages`.
    """
    plan_as_shown = frames.plan
    gains = FrameGains(gains_of_pairs(plan_as_shown, samples.scattered))
    bits, white_gain = fit_bits(plan_as_shown, samples.scattered)
    code_images = CodeImages.fold(frames.with_gains(gains), bits, white_gain, log_exposure)
    samples = with_white_as_in_patterns(plan_as_shown, samples, white_gain)
    findings = [*_brighter_white(plan_as_shown, white_gain)]
    mosaic = log_mosaic(code_images.white) if log_exposure is None else None
    if mosaic is not None:
        code_images = replace(code_images, log_exposure=mosaic)
        message = "The frames are raw ones of a colour camera, pixel by pixel behind filters; they are taken as grey."
        findings.append(Finding(RAW_COLOURS, Severity.WARNING, message))
    levels = samples.scattered.as_taken
    saturation = saturation_level(code_images.peak)
    noise = measure_noise(plan_as_shown, samples.scattered, saturation)
    inconsistent = _inconsistent_pixels(plan_as_shown, samples, noise)
    gains = gains.with_fringes(plan_as_shown, samples.scattered, _static_and_lit(samples.scattered, inconsistent))
    code_images = replace(code_images, frames=frames.with_gains(gains))
    samples = gains.without(plan_as_shown, samples)
    sample, tiles, grid = samples.scattered, samples.tiles, samples.grid
    if grid.is_divided:
        noise = measure_noise(plan_as_shown, sample, saturation)
    code_images, blurred = drop_lost_fringes(code_images, noise, sample)
    code_images, unresolved = resolve_bits(code_images, noise, sample.pixels)
    findings += [*([blurred] if blurred else []), *unresolved]
    if grid.is_divided or code_images.plan != plan_as_shown:
        inconsistent = _inconsistent_pixels(code_images.plan, samples, noise)
    if inconsistent is not None:
        static_levels = grid.levels[:, grid.of(inconsistent.static)]
        inconsistent = inconsistent if agree(code_images.plan, static_levels, noise, saturation) else None
    if inconsistent is not None:
        tiles = tiles.leaving_out(inconsistent.moved)
        findings.append(inconsistent.finding(code_images.plan))
    plan = code_images.plan
    x, y = signals_of(
        code_images, lambda image: tiles.of(image)[None], lambda frame: tiles.level(plan.shown.index(frame))
    )
    aside = ThreadPoolExecutor(1)
    fringes = ObservedFringes(plan, tiles, (x, y), noise, saturation, projector_size)
    motion = aside.submit(measure_motion, fringes)
    aside.shutdown(wait=False)
    observed = Observations(
        levels,
        noise,
        saturation,
        gains.flicker,
        motion,
        shifts_of_codes(fringes),
        tuple(findings),
        lambda: find_phase_jump(fringes),
        inconsistent,
    )
    return code_images, samples, observed


def _inconsistent_pixels(plan: SequencePlan, samples: Samples, noise: NoiseModel) -> InconsistentPixels | None:
    """Find moving objects; None if too few static pixels remain, or if exchanged frames explain the finding."""
    pixels = find_inconsistent_pixels(plan, samples.grid, noise)
    if pixels is None or np.count_nonzero(samples.grid.of(pixels.static)) < FEWEST_PIXELS:
        return None
    levels = samples.scattered.levels[:, samples.scattered.of(pixels.moved)]
    return None if is_explained_by_swap(plan, levels, pixels.frames) else pixels


def _brighter_white(plan: SequencePlan, gain: float) -> Iterator[Finding]:
    """Yield a warning if white is brighter in the patterns than in the white frame."""
    if gain != 1 and plan.white is not None:
        message = (
            f"White is {gain:.2f} times as bright in the patterns as in the white frame, which was taken into account."
        )
        values = {"brightness_ratio": float(gain)}
        yield Finding(BRIGHTER_WHITE, Severity.WARNING, message, BRIGHTER_WHITE.remedy, values)


def _static_and_lit(sample: Sample, inconsistent: InconsistentPixels | None) -> Ints:
    """Return the lit pixels of a sample but for those where something moved, which changes their brightness."""
    lit = lit_by(np.ptp(sample.levels, axis=0))
    static = lit if inconsistent is None else lit[sample.of(inconsistent.static)[lit]]
    return static if len(static) >= FEWEST_PIXELS else lit


@dataclass(frozen=True)
class CalibratedAxes:
    """What a sample tells of decoding both axes."""

    decoders: tuple[AxisDecoder, AxisDecoder]
    """With tolerances calibrated on it."""
    modulation: float | None
    """As in `Decoding`."""
    anomalies: tuple[Finding, ...]
    """What is wrong with the frames and may do no harm."""

    @property
    def unchecked(self) -> list[Unchecked]:
        """The systematic errors of axes which nothing in the capture checks."""
        return [axis.unchecked for axis in self.decoders if isinstance(axis, FringeAxis) and axis.unchecked]


def calibrate_axes(code_images: CodeImages, sample: Sample, observed: Observations) -> CalibratedAxes:
    """Check the frames and calibrate the decoders on the sample. Raises InputError."""
    plan, levels, moved = code_images.plan, sample.levels, observed.moved
    static = sample if moved is None else sample.without(moved)
    x, y = signals_of(code_images, lambda image: static.of(image)[None], static.level)
    thin = x, y
    anomalies: list[Finding] = []
    with annotate_errors(anomalies), ThreadPoolExecutor(1) as aside:
        # Errors in the frames are reported before any error of the calibration.
        calibrating = aside.submit(calibrated_decoders, plan, observed.noise, observed.saturation, thin, static.levels)
        anomalies += check_frames(
            plan, observed.levels.astype(np.float32), levels, observed.noise, observed.saturation
        )[0]
        code_anomalies = check_codes(
            plan, code_images.codes, observed.noise, code_images.threshold, code_images.white, moved
        )
        anomalies += _explained(plan, code_anomalies, anomalies, observed.inconsistent)
        decoders = calibrating.result()
        with attribute_to_shifts(observed.code_shifts):
            measured = measured_widely(decoders, thin)
            for decoder, of_axis in measured:
                anomalies += check_fringes(plan, decoder, of_axis)
    return CalibratedAxes(decoders, modulation(of_axis for _, of_axis in measured), tuple(anomalies))


def _explained(
    plan: SequencePlan,
    code_anomalies: Sequence[Finding],
    anomalies: Sequence[Finding],
    inconsistent: InconsistentPixels | None,
) -> Sequence[Finding]:
    """Return the `code_anomalies` if each is explained by inconsistent bit pairs in `anomalies` or by motion in or
    next to its frames.

    Raises InputError otherwise. An exchange between pairs shows in the sums of those pairs; other errors have no second
    indication.
    """
    moved = set() if inconsistent is None else _with_next(plan, inconsistent.frames)
    suspects = suspected(anomalies)
    for anomaly in code_anomalies:
        frames = {*anomaly.numbers("frames")}
        doubted = suspects & frames
        if not moved & frames and not any({*pair} <= doubted for pair in plan.complements):
            raise InputError(anomaly.message)
    return code_anomalies


def _with_next(plan: SequencePlan, frames: Sequence[int]) -> set[int]:
    """Return the frames together with those shown just before and just after.

    Where something moves through bits without an inverse, it is only detected in frames where it is brighter than white
    or darker than black.
    """
    places = [plan.shown.index(frame) + by for frame in frames for by in (-1, 0, 1)]
    return {plan.shown[place] for place in places if 0 <= place < len(plan.shown)}
