"""The stream's frames → matches: which projector pixel lit each camera pixel, and how sure of it we are.

Each frame is folded in as it arrives; what is kept of it are a few running images and a thin sample. No threshold has
to be chosen: noise, saturation and tolerances are measured from the capture.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Matches
from calib.numerics import Image
from calib.refinement import Shift
from scanner.decoding.accumulators import Accumulators
from scanner.decoding.checked_maps import checked_maps
from scanner.decoding.checks.consequences import judge, suspecting
from scanner.decoding.checks.contradictions import Oddity
from scanner.decoding.checks.operator_advice import too_dark, warnings_of
from scanner.decoding.finest_stripes import FinestStripes, finest_stripes
from scanner.decoding.fringes.period_shift import between_periods_px
from scanner.decoding.fringes.systematic_error import SMOOTH_PX, smooth_error_px
from scanner.decoding.fringes.unchecked import remark_on, shift_of
from scanner.decoding.halves import EvenlyLit, halves_of, motion_between
from scanner.decoding.kept_matches import match_kept
from scanner.decoding.learning import learn, look
from scanner.decoding.light.equalise import PairEqualiser
from scanner.decoding.light.exposure_fusion import ExposureMerger, exposures_of
from scanner.decoding.light.ghost import Ghost, GhostRemover, find_ghost
from scanner.decoding.light.noise_model import NoiseModel, needs_neighbours
from scanner.decoding.light.saturation_level import saturation_level
from scanner.decoding.light_switch import LightRemover, LightSwitch
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.memory import refuse_more_than_there_is
from scanner.decoding.motion import (
    CoarseFrames,
    MotionFound,
    TileSample,
    blaming_motion,
    blaming_shifts,
    refuse_untold,
    refuse_whole_periods,
    remarks_on,
)
from scanner.decoding.one_axis import one_axis
from scanner.decoding.pixel_sample import Sample
from scanner.decoding.planning import plan_sequence
from scanner.errors import InputError
from scanner.patterns import Axis, Pattern

__all__ = ["Decoder", "Decoding", "MaskReason"]

_DEPTHS = (np.uint8, np.uint16)


@dataclass(frozen=True)
class Decoding:
    """What a capture says.

    `matches` with `sigma_px`, one per decoded camera pixel; where neither fringes nor edges of stripes refine the
    cells of the codes one per cell, at the centre of the camera pixels that see it. `texture`: the scene fully lit,
    (H, W) or (H, W, 3), as the camera gave it. `reasons`: (H, W), a `MaskReason` for each camera pixel. `noise`: of
    a camera pixel, in grey levels.
    `modulation`: median amplitude of the finest fringes relative to the mean brightness, None without fringes.
    `flicker`: how much the brightness varies between frames, relative; None where no frames must be equally bright.
    `footprint_px2`: variance of what a camera pixel sees, along an axis, in camera pixels; 0 if unknown.
    `warnings`: sentences for the operator; `darkness`: the one on frames that are too dark to decode well, if they are.
    `motion`: of the devices while the fringes were taken; None if unknown. `only_axis`: the only one along which
    patterns varied, so that the other coordinate follows from a calibration, and `sigma_px` is along the epipolar line;
    None if both were measured. `smooth_px`: by what the coordinates err smoothly over a surface, as of `Shifts`.
    `shifts`: what else they err by, as of `Shifts.decoding`. `stripes`: what arrives of the finest ones' contrast; None
    where that cannot be told.
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
    footprint_px2: float = 0.0
    smooth_px: float = SMOOTH_PX
    shifts: tuple[Shift, ...] = ()
    stripes: FinestStripes | None = None


class Decoder:
    """Takes the frames of a sequence that is known in advance, one by one, and decodes them at the end.

    Where each pattern follows itself as often as every other, its frames are those of several exposures, white first.

    Given the rig's calibration, patterns along one axis are enough. `ghost`: of the picture before, which is taken out.
    `switch`: of light that is taken out, once all frames were measured. Raises InputError if the patterns
    do not determine both coordinates of a projector of (width, height) pixels.
    """

    def __init__(
        self,
        patterns: Sequence[Pattern],
        projector_size: tuple[int, int],
        calibration: Calibration | None = None,
        *,
        ghost: Ghost | None = None,
        switch: LightSwitch | None = None,
    ) -> None:
        once, repeats = exposures_of(patterns)
        plan = plan_sequence(once, projector_size, calibrated=calibration is not None)
        self._plan = replace(plan, repeats=repeats)
        self._one_axis = one_axis(plan, calibration)
        self._merger = ExposureMerger(once, repeats) if repeats > 1 else None
        self._ghost, self._remover = ghost, GhostRemover(ghost) if ghost else None
        self._switch, self._light = switch, LightRemover(self._plan, switch) if switch else None
        self._count = 0
        self._of_fringes = frozenset(frame for fringe in plan.fringes for frame in fringe.frames)
        self._projector_size = projector_size
        self._held: tuple[Accumulators, Sample, TileSample, CoarseFrames] | None = None
        self._lit: EvenlyLit | None = None
        self._texture: Image | None = None

    def measure_light(self, place: int, image: Image) -> None:
        """See how much light a frame, in a place of the capture, has that was switched on; before any is added."""
        if self._light is not None:
            self._light.measure(place, _grey(image))

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
        grey = self._remover.remove(_grey(image)) if self._remover else _grey(image)
        grey = self._light.remove(self._count, grey) if self._light else grey
        if self._held is None:
            shape = grey.shape[0], grey.shape[1]
            refuse_more_than_there_is(shape, codes_alone=not self._plan.fringes)
            sample = Sample(shape, neighbours=needs_neighbours(self._plan))
            accumulators = Accumulators(self._plan, grey, PairEqualiser(self._plan, sample, shape), sample.pixels)
            self._held = accumulators, sample, TileSample(shape), CoarseFrames(shape)
            halves = halves_of(self._plan)
            self._lit = EvenlyLit(halves, shape) if halves else None
        accumulators, sample, tiles, coarse = self._held
        number = self._plan.shown[self._count]
        if number in self._of_fringes:
            tiles.add(self._count, grey)
        # A pattern that was shown before is a witness of what has changed since, and nothing else.
        if number not in self._plan.shown[: self._count]:
            sample.add(grey)
            coarse.add(grey)
            for frame, made_alike in accumulators.add(number, grey).items():
                if self._lit is not None:
                    self._lit.add(frame, made_alike)
            self._note_texture(image, number)
        self._count += 1

    def ghost(self) -> Ghost | None:
        """What the frames were found to show of the picture before, before they are decoded.

        It takes another decoder, that is told of it, to take it out.
        """
        if self._held is None or self._count < len(self._plan.shown) or self._ghost or self._merger is not None:
            return None
        accumulators, sample, *_ = self._held
        rows = sample.pixels // accumulators.brightest.shape[1]
        return find_ghost(self._plan, sample.levels, rows, saturation_level(accumulators.peak))

    def finish(self, *, once_more: bool = False) -> Decoding:
        """Decode; a decoder does so once. Raises InputError if frames are missing or contradict the sequence.

        `once_more`: the frames can be had again; raises LightSwitchedError where it takes a decoder that is told of it.
        """
        if self._count < len(self._plan.shown):
            raise InputError(
                f"the sequence has {self._plan.frame_count} frames, found {self._plan.repeats * self._count}; the "
                f"first that is missing: {self._plan.name(self._plan.shown[self._count])}"
            )
        if self._held is None or self._texture is None:
            raise RuntimeError("this decoder has finished already")
        (accumulators, sample, tiles, coarse), self._held = self._held, None
        if self._merger is not None:
            accumulators.log_exposure = self._merger.log_exposure
        seen = look(accumulators, sample, tiles, coarse, self._projector_size)
        del tiles, coarse
        oddities: list[Oddity] = []
        with blaming_motion(lambda: seen.motion, seen.broken):
            with suspecting(oddities):
                learnt = learn(accumulators, sample, seen, oddities, once_more=once_more and not self._mended)
                maps, by_pixel = checked_maps(accumulators, learnt, seen, odd=bool(oddities))
                stripes = finest_stripes(accumulators, sample, maps)
                del sample
                motion = seen.motion
                if self._lit is not None:
                    motion = motion_between(
                        self._lit, accumulators.plan, maps.projector_px, self._projector_size, motion
                    )
                    self._lit = None
                if motion is not None and motion.significant and not motion.is_too_large:
                    motion.shift.take_back(maps.projector_px)
                # The running images are as large as the matches, and have served.
                plan, brightest = accumulators.plan, accumulators.brightest
                del accumulators
            with blaming_shifts(plan, seen.code_shifts):
                with suspecting(oddities):
                    matches, reasons = match_kept(plan, maps, brightest, self._one_axis, by_pixel=by_pixel)
                odd = (judge(oddities, reasons, matches, one_axis=self._one_axis is not None),) if oddities else ()
                refuse_whole_periods(plan, seen.code_shifts)
                if seen.unrest is None:
                    refuse_untold(plan, {frame for oddity in oddities for frame in oddity.frames}, seen.motion)
        darkness = too_dark(seen.levels, seen.noise)
        told = warnings_of(reasons, learnt.modulation, seen.flicker, darkness)
        unchecked = [decoder.unchecked for decoder in learnt.decoders if decoder.unchecked]
        told_alone = (remark_on(unchecked),) if unchecked else ()
        return Decoding(
            matches,
            self._texture if self._merger is None else self._merger.alike(self._texture),
            reasons,
            seen.noise,
            learnt.modulation,
            (*odd, *self._said_of_mending(), *seen.notes, *told_alone, *told, *remarks_on(motion)),
            flicker=seen.flicker,
            motion=motion,
            only_axis=self._one_axis.measured.axis if self._one_axis else None,
            darkness=darkness,
            footprint_px2=maps.footprint_px2,
            smooth_px=hypot(smooth_error_px(plan.fringes), between_periods_px(plan, motion)),
            shifts=(shift_of(unchecked),) if unchecked else (),
            stripes=stripes,
        )

    @property
    def _mended(self) -> bool:
        return bool(self._ghost or self._switch or self._merger)

    def _said_of_mending(self) -> Iterator[str]:
        if self._switch:
            said = self._switch.said(self._plan)
            yield f"{said[0].upper()}{said[1:]}, and was taken out. Better: leave the room's light as it is."
        if self._ghost:
            said = self._ghost.said(self._plan)
            yield f"{said[0].upper()}{said[1:]}, which was taken out. Let the camera wait longer for the projector."

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


def _grey(image: Image) -> Image:
    return cast(Image, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if image.ndim == 3 else image


def _form(image: Image) -> str:
    colour = "BGR" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]} {colour}, {8 * image.itemsize} bits"
