"""The stream's frames → matches: which projector pixel lit each camera pixel, and how sure of it we are.

Each frame is kept, and folded in as it arrives: into a few running images and a thin sample. No threshold has to be
chosen: noise, saturation and tolerances are measured from the capture.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Literal, cast, overload

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Matches
from calib.numerics import Image
from calib.refinement import Shift
from scanner.decoding.ambient_light_change import AmbientLightChange
from scanner.decoding.between_axes import motion_between
from scanner.decoding.checked_maps import checked_maps
from scanner.decoding.checks.consequences import judge, suspecting
from scanner.decoding.checks.contradictions import Anomaly
from scanner.decoding.checks.operator_advice import too_dark, warnings_of
from scanner.decoding.finest_stripes import FinestStripes, finest_stripes
from scanner.decoding.folded import Folded, folded
from scanner.decoding.fringes.period_shift import between_periods_px
from scanner.decoding.fringes.systematic_error import SMOOTH_PX, smooth_error_px
from scanner.decoding.fringes.unchecked import remark_on, shift_of
from scanner.decoding.kept_matches import match_kept
from scanner.decoding.learning import learn, look
from scanner.decoding.light.exposure_fusion import ExposureMerger, exposures_of
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.motion import (
    MotionFound,
    blaming_motion,
    blaming_shifts,
    refuse_period_slips,
    refuse_unexplained_motion,
    remarks_on,
)
from scanner.decoding.one_axis import one_axis
from scanner.decoding.planning import plan_sequence
from scanner.decoding.reading import Reading
from scanner.decoding.stack import Stack
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

    def warning(self, sentence: str) -> "Decoding":
        """The same with a sentence for the operator, before the others."""
        return replace(self, warnings=(sentence[0].upper() + sentence[1:], *self.warnings))


class Decoder:
    """Takes the frames of a sequence that is known in advance, one by one, and decodes them at the end.

    Where each pattern follows itself as often as every other, its frames are those of several exposures, white first.

    Given the rig's calibration, patterns along one axis are enough. `as_taken`: neither a ghost nor light that was
    switched is taken out of the frames. Raises InputError if the patterns do not determine both coordinates of a
    projector of (width, height) pixels.
    """

    def __init__(
        self,
        patterns: Sequence[Pattern],
        projector_size: tuple[int, int],
        calibration: Calibration | None = None,
        *,
        as_taken: bool = False,
    ) -> None:
        once, repeats = exposures_of(patterns)
        plan = plan_sequence(once, projector_size, calibrated=calibration is not None)
        self._plan = replace(plan, repeats=repeats)
        self._one_axis = one_axis(plan, calibration)
        self._merger = ExposureMerger(once, repeats) if repeats > 1 else None
        self._as_taken = as_taken or repeats > 1
        self._count = 0
        self._projector_size = projector_size
        self._stack: Stack | None = None
        self._folded: Folded | None = None
        self._texture: Image | None = None

    def add(self, image: Image, exposure_us: float | None = None) -> None:
        """Keep the next frame, (H, W) grey or (H, W, 3) BGR, 8 or 16 bit; its exposure matters if there are several.

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
        grey = _grey(image)
        if self._stack is None or self._folded is None:
            self._stack = Stack(len(self._plan.shown), grey, codes_alone=not self._plan.fringes)
            self._folded = Folded(self._plan, grey)
        self._folded.add(self._stack.keep(grey))
        number = self._plan.shown[self._count]
        if number not in self._plan.shown[: self._count]:
            self._note_texture(image, number)
        self._count += 1

    def finish(self) -> Decoding:
        """Decode; a decoder does so once. Raises InputError if frames are missing or contradict the sequence."""
        if self._count < len(self._plan.shown):
            raise InputError(
                f"the sequence has {self._plan.frame_count} frames, found {self._plan.repeats * self._count}; the "
                f"first that is missing: {self._plan.name(self._plan.shown[self._count])}"
            )
        if self._stack is None or self._folded is None:
            raise RuntimeError("this decoder has finished already")
        frames, self._stack = self._stack.frames, None
        reading = Reading() if self._as_taken else self._folded.reading()
        noise = self._folded.noise() if reading.response else None
        if not reading.is_plain:
            self._read(frames, reading)
        found = self._decode(as_taken=self._as_taken or reading.ghost is not None)
        if isinstance(found, AmbientLightChange):
            reading, found = self._in_one_light(frames, replace(reading, switch=found))
        for sentence in reading.said(self._plan):
            found = found.warning(sentence)
        return replace(found, noise=noise) if noise else found

    def _read(self, frames: Image, reading: Reading) -> None:
        self._folded = folded(self._plan, reading.undone(frames, self._plan))

    def _in_one_light(self, frames: Image, reading: Reading) -> tuple[Reading, Decoding]:
        """The frames (N, H, W) without light that was switched on or off; if they then make no sense, with it: what
        looked like light was something else.
        """
        self._read(frames, reading)
        try:
            return reading, self._decode(as_taken=True)
        except InputError as without:
            reading = replace(reading, switch=None)
            self._read(frames, reading)
            try:
                return reading, self._decode(as_taken=True)
            except InputError:
                raise without from None

    @overload
    def _decode(self, *, as_taken: Literal[True]) -> Decoding: ...

    @overload
    def _decode(self, *, as_taken: bool) -> Decoding | AmbientLightChange: ...

    def _decode(self, *, as_taken: bool) -> Decoding | AmbientLightChange:
        """The frames as they were folded, which are let go; light that had better be taken out, unless `as_taken`."""
        if self._folded is None or self._texture is None:
            raise RuntimeError("no frames were folded")
        whole, self._folded = self._folded, None
        accumulators, sample, lit = whole.accumulators, whole.sample, whole.lit
        if self._merger is not None:
            accumulators.log_exposure = self._merger.log_exposure
        seen = look(accumulators, sample, whole.tiles, whole.coarse, self._projector_size)
        del whole
        anomalies: list[Anomaly] = []
        with blaming_motion(lambda: seen.motion, seen.broken):
            with suspecting(anomalies):
                learnt = learn(accumulators, sample, seen, anomalies, as_taken=as_taken)
                if isinstance(learnt, AmbientLightChange):
                    return learnt
                maps, by_pixel = checked_maps(accumulators, learnt, seen, is_anomalous=bool(anomalies))
                stripes = finest_stripes(accumulators, sample, maps)
                del sample
                motion = seen.motion
                if lit is not None:
                    motion = motion_between(lit, accumulators.plan, maps.projector_px, self._projector_size, motion)
                    del lit
                if motion is not None and motion.significant and not motion.is_too_large:
                    motion.shift.take_back(maps.projector_px)
                # The running images are as large as the matches, and have served.
                plan, brightest = accumulators.plan, accumulators.brightest
                del accumulators
            with blaming_shifts(plan, seen.code_shifts):
                with suspecting(anomalies):
                    matches, reasons = match_kept(plan, maps, brightest, self._one_axis, by_pixel=by_pixel)
                judged = (judge(anomalies, reasons, matches, one_axis=self._one_axis is not None),) if anomalies else ()
                refuse_period_slips(plan, seen.code_shifts)
                if seen.inconsistent is None:
                    refuse_unexplained_motion(
                        plan, {frame for anomaly in anomalies for frame in anomaly.frames}, seen.motion
                    )
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
            (*judged, *seen.notes, *told_alone, *told, *remarks_on(motion)),
            flicker=seen.flicker,
            motion=motion,
            only_axis=self._one_axis.measured.axis if self._one_axis else None,
            darkness=darkness,
            footprint_px2=maps.footprint_px2,
            smooth_px=hypot(smooth_error_px(plan.fringes), between_periods_px(plan, motion)),
            shifts=(shift_of(unchecked),) if unchecked else (),
            stripes=stripes,
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
        if number == self._plan.white and image.ndim == 2 and self._folded is not None:
            self._texture = self._folded.accumulators.brightest
        elif self._texture is None or number == self._plan.white:
            self._texture = image.copy()
        elif self._plan.white is None:
            cv2.max(self._texture, image, dst=self._texture)


def _grey(image: Image) -> Image:
    return cast(Image, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if image.ndim == 3 else image


def _form(image: Image) -> str:
    colour = "BGR" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]} {colour}, {8 * image.itemsize} bits"
