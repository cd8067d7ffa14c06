"""Decode a stream of frames into matches: the projector pixel that lit each camera pixel, with its standard deviation.

Each frame is kept, and sampled as it arrives. No threshold has to be chosen: noise, saturation and tolerances are
measured from the capture.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.estimation import Shift
from calib.finding import Finding
from calib.geometry import Calibration, Matches
from calib.numerics import Bools, Image
from scanner.decoding.coordinates.code_images import CodeImages
from scanner.decoding.coordinates.coordinate_maps import Maps, coordinate_maps
from scanner.decoding.coordinates.edge_refinement import check_roughness, refine_by_edges, widen_by_roughness
from scanner.decoding.corrections.corrected_frames import (
    CorrectedFrames,
    FrameCorrections,
    Stack,
    corrections_of,
    is_copy,
    late_places,
    patterns_without,
    saturation_of,
)
from scanner.decoding.fringes.single_fringe import shift_of, unchecked_finding
from scanner.decoding.fringes.systematic_error import SMOOTH_PX, smooth_error_px
from scanner.decoding.image_quality import FinestStripes, finest_stripes, too_dark, warnings_of
from scanner.decoding.light.ambient_light_change import AmbientLightChange
from scanner.decoding.light.exposures import ExposureMerger, exposures_of
from scanner.decoding.light.photometric_constraints import suspected
from scanner.decoding.light.samples import NoiseModel, Samples, measure_noise, needs_neighbours
from scanner.decoding.map_checks import annotate_errors, assess_anomalies, check_cycles, leave_out_stray_light
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.matches import OneAxis, match_kept, one_axis, one_axis_finding
from scanner.decoding.motion import (
    MotionEstimate,
    attribute_to_motion,
    attribute_to_shifts,
    mask_wrong_bits,
    motion_findings,
    refuse_period_slips,
    refuse_unexplained_motion,
)
from scanner.decoding.motion.between_axes import halves_of, motion_between
from scanner.decoding.motion.device_motion import between_periods_px
from scanner.decoding.motion.inconsistent_pixels import InconsistentPixels
from scanner.decoding.motion.wrong_bits import repair_bits
from scanner.decoding.planning import plan_sequence
from scanner.decoding.sample_analysis import CalibratedDecoders, Observations, check_and_calibrate, observe
from scanner.decoding.sequence_plan import SequencePlan
from scanner.errors import InputError
from scanner.patterns import Axis, Pattern


def checked_maps(
    code_images: CodeImages,
    calibrated: CalibratedDecoders,
    observed: Observations,
    *,
    is_anomalous: bool,
) -> tuple[Maps, bool]:
    """Return the maps, and whether each pixel has its own coordinate (from fringes or stripe edges) or that of its
    cell.

    `is_anomalous`: whether the frame checks found an anomaly. Raises InputError if neighbours contradict each other
    all over the image, RefusalError if something moved between codes and fringes.
    """
    plan = code_images.plan
    inconsistent = observed.inconsistent
    corrupted = None if inconsistent is None else inconsistent.corrupted & ~_repaired(code_images, inconsistent)
    maps = coordinate_maps(code_images, calibrated.decoders, observed.moved, corrupted)
    if observed.moved is not None and not observed.code_shifts:
        mask_wrong_bits(plan, maps, observed.moved)
    elif is_anomalous and not plan.fringes:
        # Before interpolation between stripe edges, which makes coordinates smooth even where a bit is wrong.
        mask_wrong_bits(plan, maps, None)
    undecided = maps.reason == np.uint8(MaskReason.UNDECIDED)
    leave_out_stray_light(code_images, maps)
    check_roughness(plan, maps)
    widen_by_roughness(plan, maps)
    for code_words in code_images.codes:
        code_words.forget_contrasts()
    refined = refine_by_edges(code_images, maps, observed.noise, undecided)
    with attribute_to_shifts(plan, observed.code_shifts):
        check_cycles(plan, maps.projector_px)
    if is_anomalous and observed.moved is None and plan.fringes:
        mask_wrong_bits(plan, maps, None)
    return maps, refined or bool(plan.fringes)


def _repaired(code_images: CodeImages, inconsistent: InconsistentPixels) -> Bools:
    """Decide corrupted bits of plain Gray codes, in place; return the pixels (H, W) at which all of them are
    decided.
    """
    unrepaired, decided = (np.zeros(code_images.white.shape, np.bool_) for _ in range(2))
    for code_words in code_images.codes:
        by_bit = {
            bit: inconsistent.corrupted_by_frames[pair]
            for bit, pair in code_words.code.pairs.items()
            if pair in inconsistent.corrupted_by_frames
        }
        if by_bit and code_words.code.base is None:
            frames = dict(code_images.equalised(frames=code_words.code.frames))
            repaired = repair_bits(code_words, by_bit, frames, inconsistent.static)
            unrepaired |= np.logical_or.reduce(list(by_bit.values())) & ~repaired
            decided |= repaired
    return decided & ~unrepaired


@dataclass(frozen=True)
class Decoding:
    """The result of decoding a capture."""

    matches: Matches
    """One per decoded camera pixel, with `sigma_px`. If only Gray codes are decoded, without refinement by stripe
    edges: one per projector cell, at the centre of the camera pixels that see it."""
    texture: Image
    """The fully lit scene, (H, W) or (H, W, 3), as the camera gave it."""
    reasons: NDArray[np.uint8]
    """(H, W), a `MaskReason` for each camera pixel."""
    noise: NoiseModel
    """Of a camera pixel, in grey levels."""
    modulation: float | None
    """Median amplitude of the finest fringes relative to the mean brightness; None without fringes."""
    findings: tuple[Finding, ...]
    """What is worth knowing about the frames, in the order in which it is shown."""
    flicker: float | None = None
    """Relative standard deviation of the frames' brightness; None if no frames must be equally bright."""
    motion: MotionEstimate | None = None
    """Of the devices while the fringes were taken; None if unknown."""
    only_axis: Axis | None = None
    """The axis along which patterns varied if it was only one; the other coordinate then comes from a calibration, and
    `sigma_px` is along the epipolar line."""
    footprint_px2: float = 0.0
    """Largest variance of a camera pixel's footprint, in square camera pixels; 0 if unknown."""
    smooth_px: float = SMOOTH_PX
    """Smooth error of the coordinates over a surface, as in `calib.refinement.Shifts`."""
    shifts: tuple[Shift, ...] = ()
    """Other systematic errors of the coordinates, as in `calib.refinement.Shifts`."""
    stripes: FinestStripes | None = None
    """Contrast of the finest stripes; None if unknown."""


class Decoder:
    """Take the frames of a known sequence one by one, and decode them at the end.

    If every pattern is repeated equally often in a row, the repeats are exposures to be merged, white first. With the
    rig's calibration, patterns along one axis are enough. Raises InputError if the patterns do not determine both
    coordinates of a projector of (width, height) pixels.
    """

    def __init__(
        self,
        patterns: Sequence[Pattern],
        projector_size: tuple[int, int],
        calibration: Calibration | None = None,
    ) -> None:
        once, repeats = exposures_of(patterns)
        self._projector_size = projector_size
        self._calibration = calibration
        self._plan, self._one_axis = self._plan_of(once, repeats)
        self._merger = ExposureMerger(once, repeats) if repeats > 1 else None
        self._count = 0
        self._copies: list[int] = []
        self._late: Finding | None = None
        self._stack: Stack | None = None
        self._samples: Samples | None = None
        self._texture: Image | None = None
        self._has_white = False

    def add(self, image: Image, exposure_us: float | None = None) -> None:
        """Keep the next frame, (H, W) grey or (H, W, 3) BGR, 8 or 16 bit; the exposure is needed if there are several.

        Raises InputError if there are too many frames, if size or type differ from the others, or if exposures do not
        fit.
        """
        self._check_form(image)
        if self._merger is None:
            self._keep(image)
            return
        merged = self._merger.add(self._plan.name(self._plan.shown[self._count]), image, exposure_us)
        if merged is not None:
            self._keep(merged)

    def _keep(self, image: Image) -> None:
        if self._stack is None:
            self._stack = Stack(len(self._plan.shown), image, codes_alone=not self._plan.fringes)
        kept = self._stack.keep(image)
        if self._merger is None and self._count and is_copy(*self._stack.frames[:-3:-1]):
            self._copies.append(self._count)
        if self._samples is None:
            self._samples = Samples.of((kept.shape[0], kept.shape[1]), neighbours=needs_neighbours(self._plan))
        self._samples.add(self._plan, self._count, kept)
        # The white frame, or without one the maximum of all frames.
        is_white = self._plan.shown[self._count] == self._plan.white and self._count not in self._copies
        if self._texture is None or is_white:
            self._texture, self._has_white = image.copy(), is_white
        elif not self._has_white:
            cv2.max(self._texture, image, dst=self._texture)
        self._count += 1

    def finish(self) -> Decoding:
        """Decode the capture, once. Raises InputError if frames are missing or contradict the sequence."""
        if self._count < len(self._plan.shown):
            raise InputError(
                f"the sequence has {self._plan.frame_count} frames, found {self._plan.repeats * self._count}; the "
                f"first that is missing: {self._plan.name(self._plan.shown[self._count])}"
            )
        if self._stack is None or self._samples is None:
            raise RuntimeError("this decoder has finished already")
        frames, samples, self._stack = self._stack.frames, self._samples, None
        is_merged = self._merger is not None
        late = late_places(self._plan, frames, samples.scattered, self._copies)
        if late:
            frames = self._leave_out(frames, late)
            samples = self._sampled(frames, FrameCorrections())
        corrections = FrameCorrections() if is_merged else corrections_of(self._plan, frames, samples.scattered)
        noise = None
        if corrections.response:
            noise = measure_noise(self._plan, samples.scattered, saturation_of(self._plan, frames))
        if corrections != FrameCorrections():
            samples = self._sampled(frames, corrections)
        is_steady = is_merged or corrections.ghost is not None
        decoding = self._decode(frames, corrections, samples, is_steady=is_steady)
        return replace(decoding, noise=noise) if noise else decoding

    def _plan_of(self, once: Sequence[Pattern], repeats: int) -> tuple[SequencePlan, OneAxis | None]:
        plan = plan_sequence(once, self._projector_size, calibrated=self._calibration is not None)
        return replace(plan, repeats=repeats), one_axis(plan, self._calibration)

    def _leave_out(self, frames: Image, late: Sequence[int]) -> Image:
        """Plan the sequence anew without its late frames, and return the others of the kept ones (N, H, W)."""
        calibrated = self._calibration is not None
        decoded_as, self._late = patterns_without(self._plan, late, self._projector_size, calibrated=calibrated)
        places = [place for place, pattern in enumerate(decoded_as) if pattern is not None]
        for number, place in enumerate(places):
            if place > number:
                frames[number] = frames[place]
        self._plan, self._one_axis = self._plan_of([pattern for pattern in decoded_as if pattern is not None], 1)
        return frames[: len(places)]

    def _sampled(self, frames: Image, corrections: FrameCorrections) -> Samples:
        """Sample the corrected frames, from the kept ones (N, H, W)."""
        read = CorrectedFrames(self._plan, frames, corrections).read
        return Samples.read(self._plan, frames.shape[1:], read, neighbours=needs_neighbours(self._plan))

    def _without_ambient_change(self, frames: Image, corrections: FrameCorrections) -> Decoding:
        """Decode the frames (N, H, W) with the ambient light change removed.

        If that raises InputError, decode them unchanged: the apparent light change was something else.
        """
        errors = []
        for tried in (corrections, replace(corrections, switch=None)):
            try:
                return self._decode(frames, tried, self._sampled(frames, tried), is_steady=True)
            except InputError as error:
                errors.append(error)
        raise errors[0]

    def _decode(self, frames: Image, corrections: FrameCorrections, samples: Samples, *, is_steady: bool) -> Decoding:
        """Decode the kept frames (N, H, W), of which corrected samples are given.

        Unless the light `is_steady`, a harmful ambient light change is removed if there is one.
        """
        if self._texture is None:
            raise RuntimeError("no frames were kept")
        code_images = CodeImages(CorrectedFrames(self._plan, frames, corrections), samples.scattered)
        if self._merger is not None:
            code_images.log_exposure = self._merger.log_exposure
        observed = observe(code_images, samples, self._projector_size)
        attributing = partial(attribute_to_motion, lambda: observed.motion, observed.phase_jump)
        anomalies: list[Finding] = []
        with attributing(), annotate_errors(anomalies):
            calibrated = check_and_calibrate(code_images, samples.scattered, observed, anomalies, is_steady=is_steady)
        if isinstance(calibrated, AmbientLightChange):
            del code_images, samples
            return self._without_ambient_change(frames, replace(corrections, switch=calibrated))
        with attributing():
            with annotate_errors(anomalies):
                maps, by_pixel = checked_maps(code_images, calibrated, observed, is_anomalous=bool(anomalies))
                stripes = finest_stripes(code_images, samples.scattered, maps)
                del samples
                code_images.codes.clear()  # the frames alone tell of motion
                motion = observed.motion
                if halves := halves_of(self._plan):
                    motion = motion_between(halves, code_images, maps.projector_px, self._projector_size, motion)
                cell_px = maps.projector_px
                if motion is not None and motion.significant and not motion.is_too_large:
                    cell_px = cell_px if by_pixel else cell_px.copy()
                    motion.shift.subtract_from(maps.projector_px)
                # The folded images are as large as the matches and no longer needed.
                plan, white = code_images.plan, code_images.white
                del code_images
            with attribute_to_shifts(plan, observed.code_shifts):
                with annotate_errors(anomalies):
                    matches, reasons = match_kept(plan, maps, white, self._one_axis, None if by_pixel else cell_px)
                judged = (
                    (assess_anomalies(anomalies, reasons, matches, one_axis=self._one_axis is not None),)
                    if anomalies
                    else ()
                )
                refuse_period_slips(plan, observed.code_shifts)
                if observed.inconsistent is None:
                    refuse_unexplained_motion(plan, suspected(anomalies), observed.motion)
        unchecked = [decoder.unchecked for decoder in calibrated.decoders if decoder.unchecked]
        findings = (
            *([self._late] if self._late else []),
            *([one_axis_finding(self._one_axis.measured.axis)] if self._one_axis else []),
            *corrections.findings(self._plan),
            *judged,
            *observed.findings,
            *([unchecked_finding(unchecked)] if unchecked else []),
            *filter(None, [too_dark(observed.levels, observed.noise)]),
            *warnings_of(reasons, calibrated.modulation, observed.flicker),
            *motion_findings(motion),
        )
        return Decoding(
            matches,
            self._texture if self._merger is None else self._merger.to_shortest_exposure(self._texture),
            reasons,
            observed.noise,
            calibrated.modulation,
            findings,
            flicker=observed.flicker,
            motion=motion,
            only_axis=self._one_axis.measured.axis if self._one_axis else None,
            footprint_px2=maps.footprint_px2,
            smooth_px=hypot(smooth_error_px(plan.fringes), between_periods_px(plan, motion)),
            shifts=(shift_of(unchecked),) if unchecked else (),
            stripes=stripes,
        )

    def _check_form(self, image: Image) -> None:
        if self._count == len(self._plan.shown):
            raise InputError(f"the sequence has {self._plan.frame_count} frames, found one more")
        name = self._plan.name(self._plan.shown[self._count])
        if (
            image.ndim not in (2, 3)
            or (image.ndim == 3 and image.shape[2] != 3)
            or image.dtype not in (np.uint8, np.uint16)
        ):
            raise InputError(
                f"{name}: expected a grey or BGR image of 8 or 16 bits, found shape {image.shape} of {image.dtype}"
            )
        if self._texture is not None and (image.shape, image.dtype) != (self._texture.shape, self._texture.dtype):
            raise InputError(
                f"{name}: expected an image like those before it, {_form(self._texture)}, found {_form(image)}"
            )


def _form(image: Image) -> str:
    colour = "BGR" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]} {colour}, {8 * image.itemsize} bits"
