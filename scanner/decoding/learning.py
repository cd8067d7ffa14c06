"""What a sample of the frames tells before pixels are decoded: noise, light, motion, tolerances, and what is odd."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Image
from scanner.decoding.accumulators import Accumulators
from scanner.decoding.ambient_light_change import AmbientLightChange
from scanner.decoding.axis_decoder import AxisDecoder
from scanner.decoding.axis_signals import signals_of
from scanner.decoding.bit_resolution import resolve_bits
from scanner.decoding.checks.code_checks import check_codes
from scanner.decoding.checks.contradictions import Anomaly
from scanner.decoding.checks.frame_checks import agree, an_exchange_explains, check_frames
from scanner.decoding.checks.map_checks import check_fringes
from scanner.decoding.fringes.blur import leave_out_lost_fringes
from scanner.decoding.light.brightness import Gains, Places, flicker_of
from scanner.decoding.light.equalise import correction, out_of_line, swings_of
from scanner.decoding.light.lit_pixels import lit_by
from scanner.decoding.light.mosaic import log_mosaic
from scanner.decoding.light.noise_model import NoiseModel, measure_noise
from scanner.decoding.light.saturation_level import saturation_level
from scanner.decoding.motion import (
    CoarseFrames,
    CodeShift,
    InconsistentPixels,
    MotionFound,
    TileSample,
    blaming_shifts,
    broken_between,
    find_inconsistent_pixels,
    measure_motion,
    shifts_of_codes,
)
from scanner.decoding.pixel_sample import Sample
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS
from scanner.decoding.tune import calibrated_decoders, modulation
from scanner.errors import InputError


@dataclass(frozen=True)
class Seen:
    """What frames have in common, beside their patterns: noise, light and motion. `levels`: of the sample, as taken.

    `inconsistent`: where something moved, if the frames agree elsewhere. Motion of the devices is measured while other
    things go on; between which frames fringes were `broken`, only if asked.
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
        """(H, W): where something moved; None if nothing did."""
        return None if self.inconsistent is None else self.inconsistent.moved

    @property
    def corrupted(self) -> Bools | None:
        """(H, W): where no coordinate can be had for it; None if nothing moved."""
        return None if self.inconsistent is None else self.inconsistent.corrupted

    @property
    def motion(self) -> MotionFound | None:
        """Once it is measured."""
        return self.measuring_motion.result()


def look(
    accumulators: Accumulators,
    sample: Sample,
    tiles: TileSample,
    coarse: CoarseFrames,
    projector_size: tuple[int, int],
) -> Seen:
    """Make frames alike in brightness, leave out what is not resolved, and see how noisy and how still it was."""
    notes = list(_finish(accumulators, sample))
    mosaic = log_mosaic(accumulators.brightest) if accumulators.log_exposure is None else None
    if mosaic is not None:
        accumulators.log_exposure = mosaic
        notes.append(
            "The frames are raw ones of a colour camera, pixel by pixel behind filters; they are taken as grey."
        )
    levels = sample.as_taken
    saturation = saturation_level(accumulators.peak)
    accumulators.forget_peaks(saturation)
    shown = accumulators.plan
    noise = measure_noise(shown, sample, saturation)
    inconsistent = _inconsistent_pixels(shown, sample, coarse, noise)
    flicker = _equalise(accumulators, sample, tiles, coarse, inconsistent)
    if coarse.are_divided:
        noise = measure_noise(accumulators.plan, sample, saturation)
    notes += leave_out_lost_fringes(accumulators, noise, sample.pixels)
    notes += resolve_bits(accumulators, noise, sample.pixels)
    if coarse.are_divided or accumulators.plan != shown:
        inconsistent = _inconsistent_pixels(accumulators.plan, sample, coarse, noise)
    if inconsistent is not None:
        resting_levels = sample.levels[:, inconsistent.resting.reshape(-1)[sample.pixels]]
        inconsistent = inconsistent if agree(accumulators.plan, resting_levels, noise, saturation) else None
    if inconsistent is not None:
        tiles.leave_out(inconsistent.moved)
        notes.append(inconsistent.message(accumulators.plan))
    plan, (x, y) = accumulators.plan, signals_of(accumulators, lambda image: tiles.of(image)[None])
    aside = ThreadPoolExecutor(1)
    motion = aside.submit(measure_motion, plan, tiles, (x, y), noise, saturation, projector_size)
    aside.shutdown(wait=False)
    return Seen(
        levels,
        noise,
        saturation,
        flicker,
        motion,
        shifts_of_codes(plan, (x, y), noise, tiles.resting),
        tuple(notes),
        lambda: broken_between(plan, tiles, noise),
        inconsistent,
    )


def _inconsistent_pixels(
    plan: SequencePlan, sample: Sample, coarse: CoarseFrames, noise: NoiseModel
) -> InconsistentPixels | None:
    """Where something moved, if enough rests to tell, and exchanged frames are not why it looks so."""
    found = find_inconsistent_pixels(plan, coarse, noise)
    if found is None or np.count_nonzero(found.resting.reshape(-1)[sample.pixels]) < FEWEST_PIXELS:
        return None
    levels = sample.levels[:, found.moved.reshape(-1)[sample.pixels]]
    return None if an_exchange_explains(plan, levels, found.frames) else found


def _finish(accumulators: Accumulators, sample: Sample) -> Iterator[str]:
    """Fold in the last frames; if white is another one in the patterns, the sample has that one, and it is said."""
    white_frame = accumulators.brightest
    white = accumulators.finish()
    number = accumulators.plan.white
    if white == 1 or number is None:
        return
    seen, of_patterns = (image.reshape(-1)[sample.pixels] for image in (white_frame, accumulators.brightest))
    sample.divide(number, np.maximum(seen, 1) / np.maximum(of_patterns, 1))
    yield (
        f"White is {white:.2f} times as bright in the patterns as in the white frame, which was taken into account. "
        "Switch off what makes the projector's or the camera's brightness depend on the picture."
    )


def _equalise(
    accumulators: Accumulators,
    sample: Sample,
    tiles: TileSample,
    coarse: CoarseFrames,
    inconsistent: InconsistentPixels | None,
) -> float | None:
    """Make frames of different brightness alike, in the samples and for good; returns the flicker, None if unknown.

    `inconsistent`: where something moved, which makes frames brighter or darker there.
    """
    plan, (height, width) = accumulators.plan, accumulators.brightest.shape
    found: list[tuple[tuple[int, ...], Gains]] = [*accumulators.gains_of_pairs.items()]
    levels = sample.levels
    lit = lit_by(np.ptp(levels, axis=0))
    if inconsistent is not None:
        resting = lit[inconsistent.resting.reshape(-1)[sample.pixels[lit]]]
        lit = resting if len(resting) >= FEWEST_PIXELS else lit
    few = sample.pixels[lit]
    middle, brightest = (
        image.reshape(-1)[few].astype(np.float32) for image in (accumulators.middle, accumulators.brightest)
    )
    places = Places(few // width, height)
    swings = swings_of(plan, levels[:, lit], places)
    for fold in accumulators.fringes:
        if fold.fringe in swings:
            gains, common = swings[fold.fringe]
            found.append((fold.fringe.frames, gains))
            if gains.matter:
                fold.correction = correction(fold.fringe, gains, places, common, middle, brightest)
    for frames, gains in found:
        if gains.matter:
            rows = sample.pixels // width
            by_rows = (gains.at(each) for each in (rows, coarse.rows, tiles.rows))
            for frame, of_frame, of_coarse, of_tiles in zip(frames, *by_rows, strict=True):
                sample.divide(frame, of_frame)
                coarse.divide(frame, of_coarse)
                tiles.divide(plan.shown.index(frame), of_tiles)
    for group, by in out_of_line([(frames, gains.matter) for frames, gains in found], sample):
        for frame in group:
            sample.divide(frame, np.array([by]))
            coarse.divide(frame, np.array([by]))
    return flicker_of([gains for _, gains in found])


@dataclass(frozen=True)
class Learnt:
    """What a sample of the frames tells: how to decode every pixel, and `modulation` as of `Decoding`."""

    decoders: tuple[AxisDecoder, AxisDecoder]
    modulation: float | None


def learn(
    accumulators: Accumulators, sample: Sample, seen: Seen, anomalies: list[Anomaly], *, as_taken: bool
) -> Learnt | AmbientLightChange:
    """Check the frames, adding to the `anomalies`, and learn tolerances from the sample. Raises InputError.

    If light was switched that had better be taken out, unless frames are decoded `as_taken`, that is the answer.
    """
    plan, levels, moved = accumulators.plan, sample.levels, seen.moved
    if moved is not None:
        sample.leave_out(moved.reshape(-1)[sample.pixels])
    x, y = signals_of(accumulators, lambda image: image.reshape(1, -1)[:, sample.pixels])
    thin = x, y
    with ThreadPoolExecutor(1) as aside:
        # What is wrong with the frames is said first, whatever comes of it here.
        calibrating = aside.submit(calibrated_decoders, plan, seen.noise, seen.saturation, thin, sample.levels)
        found, switch = check_frames(plan, seen.levels.astype(np.float32), levels, seen.noise, seen.saturation)
        if not as_taken and switch is not None and switch.is_harmful:
            return switch
        anomalies += found
        code_anomalies = check_codes(
            plan, accumulators.codes, seen.noise, accumulators.middle, accumulators.brightest, moved
        )
        anomalies += _passed_over(plan, code_anomalies, anomalies, seen.inconsistent)
        decoders = calibrating.result()
        with blaming_shifts(plan, seen.code_shifts):
            for decoder, signals in zip(decoders, thin, strict=True):
                anomalies += check_fringes(plan, decoder, signals)
        accumulators.forget_contrasts()
        return Learnt(decoders, modulation(decoders, thin))


def _passed_over(
    plan: SequencePlan,
    code_anomalies: Sequence[Anomaly],
    seen: Sequence[Anomaly],
    inconsistent: InconsistentPixels | None,
) -> Sequence[Anomaly]:
    """The odd codes, if pairs of their bits were `seen` not to add up, or something moved in their frames or next to.

    Raises InputError if one was not: an exchange between pairs is known from their sums, but nothing else tells others.
    """
    moved = set() if inconsistent is None else _with_next(plan, inconsistent.frames)
    suspected = {frame for anomaly in seen for frame in anomaly.frames}
    for anomaly in code_anomalies:
        doubted = suspected.intersection(anomaly.frames)
        if not moved & {*anomaly.frames} and not any({*pair} <= doubted for pair in plan.complements):
            raise InputError(anomaly.message)
    return code_anomalies


def _with_next(plan: SequencePlan, frames: Sequence[int]) -> set[int]:
    """Frames with those that were taken before and after: of what moves through bits without inverses only those tell
    in which it is brighter than white or darker than black.
    """
    places = [plan.shown.index(frame) + by for frame in frames for by in (-1, 0, 1)]
    return {plan.shown[place] for place in places if 0 <= place < len(plan.shown)}
