"""Observe a capture from a sample of its pixels before full decoding: noise, ambient light, motion, frame checks."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Image
from scanner.decoding.ambient_light_change import AmbientLightChange
from scanner.decoding.axis_decoder import AxisDecoder
from scanner.decoding.checks.code_checks import check_codes
from scanner.decoding.checks.frame_checks import agree, an_exchange_explains, check_frames
from scanner.decoding.checks.frame_consistency import Anomaly
from scanner.decoding.checks.map_checks import check_fringes
from scanner.decoding.code_images import FoldedFrames, signals_of
from scanner.decoding.decoder_calibration import calibrated_decoders, measured_widely, modulation
from scanner.decoding.light.brightness import Gains, Places, flicker_of
from scanner.decoding.light.equalise import outlier_groups, swings_of
from scanner.decoding.light.lit_pixels import lit_by, log_mosaic, saturation_level
from scanner.decoding.light.noise_model import NoiseModel, measure_noise
from scanner.decoding.motion import (
    CodeShift,
    InconsistentPixels,
    MotionFound,
    SeenFringes,
    blaming_shifts,
    broken_between,
    find_inconsistent_pixels,
    measure_motion,
    shifts_of_codes,
)
from scanner.decoding.resolution import drop_lost_fringes, resolve_bits
from scanner.decoding.samples import Sample, Samples
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS
from scanner.errors import InputError


@dataclass(frozen=True)
class Observations:
    """Properties of the capture that do not depend on the pattern code: noise, light and motion.

    `levels`: the sample's grey levels as taken, (frames, P). `flicker`: as in `Decoding`. `measuring_motion`: the
    device motion, measured in the background. `notes`: sentences for the operator. `broken`: finds, on request, the two
    frames between which fringes jumped. `inconsistent`: where an object moved, if the frames agree elsewhere;
    None otherwise.
    """

    levels: Image
    noise: NoiseModel
    saturation: float
    flicker: float | None
    measuring_motion: Future[MotionFound | None]
    code_shifts: tuple[CodeShift, ...]
    notes: tuple[str, ...]
    broken: Callable[[], tuple[int, int] | None]
    inconsistent: InconsistentPixels | None = None

    @property
    def moved(self) -> Bools | None:
        """(H, W): True where something moved; None if nothing did."""
        return None if self.inconsistent is None else self.inconsistent.moved

    @property
    def motion(self) -> MotionFound | None:
        """The motion of the devices; waits for its measurement to finish."""
        return self.measuring_motion.result()


def observe(folded: FoldedFrames, samples: Samples, projector_size: tuple[int, int]) -> Observations:
    """Equalise the frames' brightness, drop unresolved fringes and bits, and measure noise, flicker and motion.

    The corrections are made in the folded frames and the samples, in place.
    """
    sample, tiles, grid = samples.scattered, samples.tiles, samples.grid
    notes = list(_with_brighter_white(folded, sample))
    mosaic = log_mosaic(folded.brightest) if folded.log_exposure is None else None
    if mosaic is not None:
        folded.log_exposure = mosaic
        notes.append(
            "The frames are raw ones of a colour camera, pixel by pixel behind filters; they are taken as grey."
        )
    levels = sample.as_taken
    saturation = saturation_level(folded.peak)
    shown = folded.plan
    noise = measure_noise(shown, sample, saturation)
    inconsistent = _inconsistent_pixels(shown, samples, noise)
    flicker = _equalise(folded, samples, inconsistent)
    if grid.is_divided:
        noise = measure_noise(folded.plan, sample, saturation)
    notes += drop_lost_fringes(folded, noise, sample)
    notes += resolve_bits(folded, noise, sample.pixels)
    if grid.is_divided or folded.plan != shown:
        inconsistent = _inconsistent_pixels(folded.plan, samples, noise)
    if inconsistent is not None:
        rests = grid.levels[:, grid.of(inconsistent.resting)]
        inconsistent = inconsistent if agree(folded.plan, rests, noise, saturation) else None
    if inconsistent is not None:
        tiles.leave_out(inconsistent.moved)
        notes.append(inconsistent.message(folded.plan))
    plan = folded.plan
    x, y = signals_of(folded, lambda image: tiles.of(image)[None], lambda frame: tiles.level(plan.shown.index(frame)))
    aside = ThreadPoolExecutor(1)
    seen = SeenFringes(plan, tiles, (x, y), noise, saturation, projector_size)
    motion = aside.submit(measure_motion, seen)
    aside.shutdown(wait=False)
    return Observations(
        levels,
        noise,
        saturation,
        flicker,
        motion,
        shifts_of_codes(seen),
        tuple(notes),
        lambda: broken_between(seen),
        inconsistent,
    )


def _inconsistent_pixels(plan: SequencePlan, samples: Samples, noise: NoiseModel) -> InconsistentPixels | None:
    """Find moving objects; None if too few static pixels remain, or if exchanged frames explain the finding."""
    found = find_inconsistent_pixels(plan, samples.grid, noise)
    if found is None or np.count_nonzero(samples.grid.of(found.resting)) < FEWEST_PIXELS:
        return None
    levels = samples.scattered.levels[:, samples.scattered.of(found.moved)]
    return None if an_exchange_explains(plan, levels, found.frames) else found


def _with_brighter_white(folded: FoldedFrames, sample: Sample) -> Iterator[str]:
    """If white is brighter in the patterns than in the white frame, rescale it in the sample and yield a warning."""
    white, number = folded.white, folded.plan.white
    if white == 1 or number is None:
        return
    seen, of_patterns = sample.level(number), sample.of(folded.brightest)
    sample.divide(number, np.maximum(seen, 1) / np.maximum(of_patterns, 1))
    yield (
        f"White is {white:.2f} times as bright in the patterns as in the white frame, which was taken into account. "
        "Switch off what makes the projector's or the camera's brightness depend on the picture."
    )


def _equalise(folded: FoldedFrames, samples: Samples, inconsistent: InconsistentPixels | None) -> float | None:
    """Equalise frames that differ in brightness, in the samples and in the fringes; return the flicker, None if
    unknown.

    `inconsistent`: where something moved; those pixels are ignored, because motion changes their brightness.
    """
    plan, sample = folded.plan, samples.scattered
    found: list[tuple[tuple[int, ...], Gains]] = [*folded.gains.items()]
    levels = sample.levels
    lit = lit_by(np.ptp(levels, axis=0))
    if inconsistent is not None:
        resting = lit[sample.of(inconsistent.resting)[lit]]
        lit = resting if len(resting) >= FEWEST_PIXELS else lit
    places = Places(sample.rows[lit], sample.shape[0])
    for fringe, gains in swings_of(plan, levels[:, lit], places).items():
        found.append((fringe.frames, gains))
        if gains.are_harmful:
            folded.equalise(fringe.frames, gains.within(places).divided)
    for frames, gains in found:
        if gains.are_harmful:
            samples.equalise(plan, frames, gains)
    for group, by in outlier_groups([(frames, gains.are_harmful) for frames, gains in found], sample):
        samples.equalise(plan, group, Gains(np.full((len(group), 1), by)))
    return flicker_of([gains for _, gains in found])


@dataclass(frozen=True)
class CalibratedDecoders:
    """The decoders of both axes with tolerances calibrated on a sample, and the `modulation` as in `Decoding`."""

    decoders: tuple[AxisDecoder, AxisDecoder]
    modulation: float | None


def check_and_calibrate(
    folded: FoldedFrames, sample: Sample, observed: Observations, anomalies: list[Anomaly], *, is_steady: bool
) -> CalibratedDecoders | AmbientLightChange:
    """Check the frames, append what is wrong to `anomalies`, and calibrate the decoders on the sample. Raises
    InputError.

    Returns the ambient light change instead if there is a harmful one to be corrected, unless the light `is_steady`.
    """
    plan, levels, moved = folded.plan, sample.levels, observed.moved
    resting = sample if moved is None else sample.without(moved)
    x, y = signals_of(folded, lambda image: resting.of(image)[None], resting.level)
    thin = x, y
    with ThreadPoolExecutor(1) as aside:
        # Errors in the frames are reported before any error of the calibration.
        calibrating = aside.submit(calibrated_decoders, plan, observed.noise, observed.saturation, thin, resting.levels)
        found, switch = check_frames(
            plan, observed.levels.astype(np.float32), levels, observed.noise, observed.saturation
        )
        if not is_steady and switch is not None and switch.is_harmful:
            return switch
        anomalies += found
        code_anomalies = check_codes(plan, folded.codes, observed.noise, folded.middle, folded.brightest, moved)
        anomalies += _explained(plan, code_anomalies, anomalies, observed.inconsistent)
        decoders = calibrating.result()
        with blaming_shifts(plan, observed.code_shifts):
            measured = measured_widely(decoders, thin)
            for decoder, of_axis in measured:
                anomalies += check_fringes(plan, decoder, of_axis)
        return CalibratedDecoders(decoders, modulation(of_axis for _, of_axis in measured))


def _explained(
    plan: SequencePlan,
    code_anomalies: Sequence[Anomaly],
    seen: Sequence[Anomaly],
    inconsistent: InconsistentPixels | None,
) -> Sequence[Anomaly]:
    """Return the `code_anomalies` if each is explained by inconsistent bit pairs in `seen` or by motion in or
    next to its frames.

    Raises InputError otherwise. An exchange between pairs shows in the sums of those pairs; other errors have no second
    indication.
    """
    moved = set() if inconsistent is None else _with_next(plan, inconsistent.frames)
    suspected = {frame for anomaly in seen for frame in anomaly.frames}
    for anomaly in code_anomalies:
        doubted = suspected.intersection(anomaly.frames)
        if not moved & {*anomaly.frames} and not any({*pair} <= doubted for pair in plan.complements):
            raise InputError(anomaly.message)
    return code_anomalies


def _with_next(plan: SequencePlan, frames: Sequence[int]) -> set[int]:
    """Return the frames together with those shown just before and just after.

    Where something moves through bits without an inverse, it is only detected in frames where it is brighter than white
    or darker than black.
    """
    places = [plan.shown.index(frame) + by for frame in frames for by in (-1, 0, 1)]
    return {plan.shown[place] for place in places if 0 <= place < len(plan.shown)}
