"""The stream's frames → matches: which projector pixel lit each camera pixel, and how sure of it we are.

Each frame is folded in as it arrives; what is kept of it are a few running images and a thin sample. No threshold has
to be chosen: noise, saturation and tolerances are measured from the capture.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Matches
from calib.numerics import Bools, Floats, Image, compiled
from scanner.decoding.accumulators import Accumulators
from scanner.decoding.arrays import Floats32
from scanner.decoding.axis_decoder import AxisDecoder
from scanner.decoding.axis_signals import signals_of
from scanner.decoding.bit_resolution import resolve_bits
from scanner.decoding.brightness import Gains, Places, flicker_of, lit_by
from scanner.decoding.code_cells import average_cells
from scanner.decoding.code_checks import check_codes
from scanner.decoding.connected_components import small_patches
from scanner.decoding.consequences import judge, suspecting
from scanner.decoding.coordinate_maps import Maps, coordinate_maps
from scanner.decoding.equalise import PairEqualiser, correction, out_of_line, swings_of
from scanner.decoding.exposure_fusion import ExposureMerger, exposures_of
from scanner.decoding.frame_checks import Oddity, check_frames
from scanner.decoding.map_checks import check_fringes, check_maps
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.motion import (
    CodeShift,
    MotionFound,
    TileSample,
    blaming_motion,
    blaming_shifts,
    measure_motion,
    remarks_on,
    shifts_of_codes,
)
from scanner.decoding.noise_model import NoiseModel, measure_noise, needs_neighbours
from scanner.decoding.one_axis import OneAxis, one_axis
from scanner.decoding.operator_advice import too_dark, warnings_of
from scanner.decoding.pixel_sample import Sample
from scanner.decoding.saturation_level import saturation_level
from scanner.decoding.sequence_plan import SequencePlan, plan_sequence
from scanner.decoding.tune import calibrated_decoders, modulation
from scanner.errors import InputError
from scanner.patterns import Axis, Pattern

__all__ = ["Decoder", "Decoding", "MaskReason"]

_DEPTHS = (np.uint8, np.uint16)


@dataclass(frozen=True)
class Decoding:
    """What a capture says.

    `matches` with `sigma_px`, one per decoded camera pixel; where no fringe refines either axis one per projector cell,
    at the centre of the camera pixels that see it. `texture`: the scene fully lit, (H, W) or (H, W, 3), as the camera
    gave it. `reasons`: (H, W), a `MaskReason` for each camera pixel. `noise`: of a camera pixel, in grey levels.
    `modulation`: median amplitude of the finest fringes relative to the mean brightness, None without fringes.
    `flicker`: how much the brightness varies between frames, relative; None where no frames must be equally bright.
    `warnings`: sentences for the operator; `darkness`: the one on frames that are too dark to decode well, if they are.
    `motion`: of the devices while the fringes were taken; None if unknown. `only_axis`: the only one along which
    patterns varied, so that the other coordinate follows from a calibration, and `sigma_px` is along the epipolar line;
    None if both were measured.
    """

    matches: Matches
    texture: Image
    reasons: NDArray[np.uint8]
    noise: NoiseModel
    modulation: float | None
    warnings: tuple[str, ...]
    flicker: float | None = None
    motion: MotionFound | None = None
    only_axis: Axis | None = None
    darkness: str | None = None


class Decoder:
    """Takes the frames of a sequence that is known in advance, one by one, and decodes them at the end.

    Where each pattern follows itself as often as every other, its frames are those of several exposures, white first.

    Given the rig's calibration, patterns along one axis are enough. Raises InputError if the patterns do not determine
    both coordinates of a projector of (width, height) pixels.
    """

    def __init__(
        self, patterns: Sequence[Pattern], projector_size: tuple[int, int], calibration: Calibration | None = None
    ) -> None:
        once, repeats = exposures_of(patterns)
        plan = plan_sequence(once, projector_size, calibrated=calibration is not None)
        self._plan = replace(plan, repeats=repeats)
        self._one_axis = one_axis(plan, calibration)
        self._merger = ExposureMerger(once, repeats) if repeats > 1 else None
        self._count = 0
        self._projector_size = projector_size
        self._held: tuple[Accumulators, Sample, TileSample] | None = None
        self._texture: Image | None = None

    def add(self, image: Image, exposure_us: float | None = None) -> None:
        """Fold in the next frame, (H, W) grey or (H, W, 3) BGR, 8 or 16 bit; its exposure matters if there are several.

        Raises InputError if it is one frame too many, or not of the size and type of the others, or if exposures do not
        fit.
        """
        self._check_form(image)
        if self._merger is None:
            self._fold(image)
            return
        merged = self._merger.add(self._plan.name(self._plan.shown[self._count]), image, exposure_us)
        if merged is not None:
            self._fold(merged)

    def _fold(self, image: Image) -> None:
        grey = cast(Image, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if image.ndim == 3 else image
        if self._held is None:
            shape = grey.shape[0], grey.shape[1]
            sample = Sample(shape, neighbours=needs_neighbours(self._plan))
            accumulators = Accumulators(self._plan, grey, PairEqualiser(self._plan, sample, shape))
            self._held = accumulators, sample, TileSample(shape)
        accumulators, sample, tiles = self._held
        tiles.add(grey)
        number = self._plan.shown[self._count]
        # A pattern that was shown before is a witness of what has changed since, and nothing else.
        if number not in self._plan.shown[: self._count]:
            sample.add(grey)
            accumulators.add(number, grey)
            self._note_texture(image, number)
        self._count += 1

    def finish(self) -> Decoding:
        """Decode; a decoder does so once. Raises InputError if frames are missing or contradict the sequence."""
        if self._count < len(self._plan.shown):
            raise InputError(
                f"the sequence has {self._plan.frame_count} frames, found {self._plan.repeats * self._count}; the "
                f"first that is missing: {self._plan.name(self._plan.shown[self._count])}"
            )
        if self._held is None or self._texture is None:
            raise RuntimeError("this decoder has finished already")
        (accumulators, sample, tiles), self._held = self._held, None
        if self._merger is not None:
            accumulators.log_exposure = self._merger.log_exposure
        seen = _look(accumulators, sample, tiles, self._projector_size)
        del tiles
        oddities: list[Oddity] = []
        with blaming_motion(seen.motion):
            with suspecting(oddities):
                learnt = _learn(accumulators, sample, seen, oddities)
                del sample
                maps = coordinate_maps(accumulators, learnt.decoders)
                if seen.motion is not None and seen.motion.significant and not seen.motion.is_too_large:
                    seen.motion.shift.take_back(maps.projector_px)
                # The running images are as large as the matches, and have served.
                plan, brightest = accumulators.plan, accumulators.brightest
                del accumulators
            with blaming_shifts(plan, seen.code_shifts):
                with suspecting(oddities):
                    matches, reasons = _match(plan, maps, brightest, self._one_axis)
                odd = (judge(oddities, reasons, matches, one_axis=self._one_axis is not None),) if oddities else ()
        darkness = too_dark(seen.levels, seen.noise)
        told = warnings_of(reasons, learnt.modulation, seen.flicker, darkness)
        return Decoding(
            matches,
            self._texture if self._merger is None else self._merger.alike(self._texture),
            reasons,
            seen.noise,
            learnt.modulation,
            (*odd, *seen.notes, *told, *remarks_on(seen.motion)),
            flicker=seen.flicker,
            motion=seen.motion,
            only_axis=self._one_axis.measured.axis if self._one_axis else None,
            darkness=darkness,
        )

    def _check_form(self, image: Image) -> None:
        if self._count == len(self._plan.shown):
            raise InputError(f"the sequence has {self._plan.frame_count} frames, found one more")
        name = self._plan.name(self._plan.shown[self._count])
        if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.dtype not in _DEPTHS:
            raise InputError(
                f"{name}: expected a grey or BGR image of 8 or 16 bits, found shape {image.shape} of {image.dtype}"
            )
        if self._texture is not None and (image.shape, image.dtype) != (self._texture.shape, self._texture.dtype):
            raise InputError(
                f"{name}: expected an image like those before it, {_form(self._texture)}, found {_form(image)}"
            )

    def _note_texture(self, image: Image, number: int) -> None:
        """Keep the white frame or, if there is none, the brightest that each pixel was."""
        if number == self._plan.white and image.ndim == 2 and self._held is not None:
            self._texture = self._held[0].brightest
        elif self._texture is None or number == self._plan.white:
            self._texture = image.copy()
        elif self._plan.white is None:
            cv2.max(self._texture, image, dst=self._texture)


def _form(image: Image) -> str:
    colour = "BGR" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]} {colour}, {8 * image.itemsize} bits"


@dataclass(frozen=True)
class _Seen:
    """What frames have in common, beside their patterns: noise, light and motion. `levels`: of the sample, as taken."""

    levels: Floats32
    noise: NoiseModel
    saturation: float
    flicker: float | None
    motion: MotionFound | None
    code_shifts: tuple[CodeShift, ...]
    notes: tuple[str, ...]


def _look(accumulators: Accumulators, sample: Sample, tiles: TileSample, projector_size: tuple[int, int]) -> _Seen:
    """Make frames alike in brightness, leave out what is not resolved, and see how noisy and how still it was."""
    accumulators.finish()
    levels = sample.levels
    flicker = _equalise(accumulators, sample, tiles)
    saturation = saturation_level(accumulators.peak)
    noise = measure_noise(accumulators.plan, sample, saturation)
    notes = tuple(resolve_bits(accumulators, noise, sample.pixels))
    motion = measure_motion(accumulators, tiles, noise, saturation, projector_size)
    return _Seen(levels, noise, saturation, flicker, motion, shifts_of_codes(accumulators, tiles, noise), notes)


def _equalise(accumulators: Accumulators, sample: Sample, tiles: TileSample) -> float | None:
    """Make frames of different brightness alike, in the samples and for good; returns the flicker, None if unknown."""
    plan, (height, width) = accumulators.plan, accumulators.brightest.shape
    found: list[tuple[tuple[int, ...], Gains]] = [*accumulators.gains_of_pairs.items()]
    levels = sample.levels
    lit = lit_by(np.ptp(levels, axis=0))
    few = sample.pixels[lit]
    middle, brightest = (
        image.reshape(-1)[few].astype(np.float32) for image in (accumulators.middle, accumulators.brightest)
    )
    swings = swings_of(plan, levels[:, lit], Places(few // width, height))
    for fold in accumulators.fringes:
        if fold.fringe in swings:
            gains, common = swings[fold.fringe]
            found.append((fold.fringe.frames, gains))
            if gains.matter:
                fold.correction = correction(fold.fringe, gains, common, middle, brightest)
    for frames, gains in found:
        if gains.matter:
            rows = sample.pixels // width
            for frame, of_frame, of_tiles in zip(frames, gains.at(rows), gains.at(tiles.rows), strict=True):
                sample.divide(frame, of_frame)
                tiles.divide(plan.shown.index(frame), of_tiles)
    for group, by in out_of_line([(frames, gains.matter) for frames, gains in found], sample):
        for frame in group:
            sample.divide(frame, np.array([by]))
    return flicker_of([gains for _, gains in found])


@dataclass(frozen=True)
class _Learnt:
    """What a sample of the frames tells: how to decode every pixel, and `modulation` as of `Decoding`."""

    decoders: tuple[AxisDecoder, AxisDecoder]
    modulation: float | None


def _learn(accumulators: Accumulators, sample: Sample, seen: _Seen, oddities: list[Oddity]) -> _Learnt:
    """Check the frames, adding to the `oddities`, and learn tolerances from the sample. Raises InputError."""
    plan = accumulators.plan
    x, y = signals_of(accumulators, lambda image: image.reshape(1, -1)[:, sample.pixels])
    thin = x, y
    with ThreadPoolExecutor(1) as aside:
        # What is wrong with the frames is said first, whatever comes of it here.
        calibrating = aside.submit(calibrated_decoders, plan, seen.noise, seen.saturation, thin)
        oddities += check_frames(plan, seen.levels, sample.levels, seen.noise, seen.saturation)
        odd_codes = check_codes(plan, accumulators.codes, seen.noise, accumulators.middle)
        oddities += _passed_over(plan, odd_codes, oddities)
        decoders = calibrating.result()
        with blaming_shifts(plan, seen.code_shifts):
            for decoder, signals in zip(decoders, thin, strict=True):
                oddities += check_fringes(plan, decoder, signals)
        accumulators.forget_contrasts()
        return _Learnt(decoders, modulation(decoders, thin))


def _passed_over(plan: SequencePlan, odd_codes: Sequence[Oddity], seen: Sequence[Oddity]) -> Sequence[Oddity]:
    """The odd codes, if pairs of their bits were `seen` not to add up, as where someone walks by.

    Raises InputError if one was not: an exchange between pairs is known from their sums, but nothing else tells others.
    """
    suspected = {frame for oddity in seen for frame in oddity.frames}
    for oddity in odd_codes:
        if not any({*pair} <= suspected.intersection(oddity.frames) for pair in plan.complements):
            raise InputError(oddity.said)
    return odd_codes


def _match(
    plan: SequencePlan, maps: Maps, brightest: Image, one_axis: OneAxis | None
) -> tuple[Matches, NDArray[np.uint8]]:
    """The matches, and for all pixels (H, W) the reason why they have none. Raises InputError; uses up the maps.

    `brightest`: (H, W) grey.
    """
    reasons = maps.reason
    if one_axis:
        # What a calibration then masks speaks against the calibration, not against the frames.
        check_maps(plan, maps, reasons == np.uint8(MaskReason.KEPT))
        one_axis.complete(maps)
    kept = reasons == np.uint8(MaskReason.KEPT)
    if plan.fringes:
        np.copyto(reasons, np.uint8(MaskReason.ISOLATED), where=small_patches(kept))
    else:
        if one_axis:
            cells = one_axis.average_stripes(kept, maps, brightest)
        else:
            cells = average_cells(kept, maps.projector_px, maps.variance, brightest)
        np.copyto(reasons, np.uint8(MaskReason.ISOLATED), where=cells.rejected)
    kept = reasons == np.uint8(MaskReason.KEPT)
    if not one_axis:
        check_maps(plan, maps, kept)
    if plan.fringes:
        return _pixel_matches(kept, maps), reasons
    return Matches(cells.camera_px, cells.projector_px, sigma_px=np.sqrt(cells.variance)), reasons


def _pixel_matches(kept: Bools, maps: Maps) -> Matches:
    """The matches of `kept` pixels (H, W), row by row, in the memory of the maps.

    Single precision is exact for the camera's pixels, and all that the maps have for the projector's.
    """
    count = int(np.count_nonzero(kept))
    camera_px, projector_px = np.empty((count, 2), np.float32), maps.projector_px.reshape(-1, 2)
    sigma_px = maps.variance.reshape(-1)
    with ThreadPoolExecutor(1) as aside:
        noted = aside.submit(_note_places, kept, camera_px)
        _gather(kept.reshape(-1), projector_px, sigma_px)
        noted.result()
    return Matches(cast(Floats, camera_px), cast(Floats, projector_px[:count]), sigma_px=cast(Floats, sigma_px[:count]))


@compiled
def _note_places(kept: Bools, camera_px: Floats32) -> None:
    """The columns and rows of the kept pixels."""
    height, width = kept.shape
    match = 0
    for row in range(height):
        for column in range(width):
            if kept[row, column]:
                camera_px[match, 0], camera_px[match, 1] = column, row
                match += 1


@compiled
def _gather(kept: Bools, projector_px: Floats32, variance: Floats32) -> None:
    """Move what belongs to the kept pixels (P, …) to the beginning, with the root of the variance in its place."""
    match = 0
    for pixel in range(len(kept)):
        if kept[pixel]:
            projector_px[match, 0], projector_px[match, 1] = projector_px[pixel, 0], projector_px[pixel, 1]
            variance[match] = np.sqrt(variance[pixel])
            match += 1
