"""Decode a stream of frames into matches: the projector pixel that lit each camera pixel, with its standard deviation.

Each frame is kept, and sampled as it arrives. `decode` is the whole way from there: what affected all frames is
corrected, noise and motion are observed in the sample, the decoders of both axes are calibrated on it, all pixels are
decoded tile by tile and refined, and what remains is checked and collected. No threshold has to be chosen: noise,
saturation and tolerances are measured from the capture.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot

import numpy as np
from numpy.typing import NDArray

from calib.estimation import Shift
from calib.finding import Finding
from calib.geometry import Calibration, Matches
from calib.numerics import Floats32, Image
from scanner.decoding.coordinates.code_images import CodeImages
from scanner.decoding.coordinates.coordinate_map import CoordinateMap, decode_tiles
from scanner.decoding.coordinates.edge_refinement import check_roughness, refine_by_edges, widen_by_roughness
from scanner.decoding.corrections.corrected_frames import CorrectedFrames, estimate_corrections
from scanner.decoding.frame_stack import FrameCollector, FrameStack
from scanner.decoding.fringes.single_fringe import shift_of, unchecked_finding
from scanner.decoding.fringes.systematic_error import SMOOTH_PX, smooth_error_px
from scanner.decoding.image_quality import FinestStripes, finest_stripes, too_dark, warnings_of
from scanner.decoding.light.constraints import NoiseModel
from scanner.decoding.light.frame_checks import suspected
from scanner.decoding.light.samples import Samples
from scanner.decoding.map_checks import annotate_errors, assess_anomalies, check_cycles, mask_stray_light
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.matches import collect_matches, one_axis, one_axis_finding
from scanner.decoding.motion import (
    MotionEstimate,
    MotionVerdict,
    attribute_to_motion,
    attribute_to_shifts,
    between_periods_px,
    halves_of,
    mask_wrong_bits,
    motion_between,
    motion_findings,
    refuse_period_slips,
    refuse_unexplained_motion,
    repair_codes,
)
from scanner.decoding.sample_analysis import CalibratedAxes, Observations, calibrate_axes, observe
from scanner.patterns import Axis, Pattern


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
        self._projector_size, self._calibration = projector_size, calibration
        self._frames = FrameCollector(patterns, projector_size, calibrated=calibration is not None)

    def add(self, image: Image, exposure_us: float | None = None) -> None:
        """Keep the next frame, (H, W) grey or (H, W, 3) BGR, 8 or 16 bit; the exposure is needed if there are several.

        Raises InputError if there are too many frames, if size or type differ from the others, or if exposures do not
        fit.
        """
        self._frames.add(image, exposure_us)

    def finish(self) -> Decoding:
        """Decode the capture, once. Raises InputError if frames are missing or contradict the sequence."""
        return decode(self._frames.complete(), self._projector_size, self._calibration)


def decode(stack: FrameStack, projector_size: tuple[int, int], calibration: Calibration | None = None) -> Decoding:
    """Decode the frames of a whole capture; the projector has (width, height) pixels.

    With the rig's calibration, patterns along one axis are enough. Raises InputError if the frames contradict the
    sequence.
    """
    corrections = estimate_corrections(stack)
    frames = CorrectedFrames(stack.plan, stack.frames, corrections)
    images, samples, observed = observe(frames, frames.sampled(stack.samples), stack.log_exposure, projector_size)
    # That of the camera itself, not of its corrected frames.
    noise = stack.noise if corrections.response else observed.noise
    with attribute_to_motion(lambda: observed.motion, observed.phase_jump):
        axes = calibrate_axes(images, samples.scattered, observed)
        plan, white, completion = images.plan, images.white, one_axis(stack.plan, calibration)
        with attribute_to_shifts(observed.code_shifts):
            with annotate_errors(axes.anomalies):
                pixels = _decode_pixels(images, samples, axes, observed, projector_size)
                del images, frames  # which are larger than what follows
                stack = stack.without_frames()
                matches, reasons = collect_matches(plan, pixels.coordinates, pixels.cells_px, white, completion)
                judged = assess_anomalies(axes.anomalies, reasons, matches, one_axis=completion is not None)
            refuse_period_slips(observed.code_shifts)
            if observed.inconsistent is None:
                refuse_unexplained_motion(plan, suspected(axes.anomalies), observed.motion)
    findings = (
        stack.finding,
        one_axis_finding(completion.measured.axis) if completion else None,
        *corrections.findings(stack.plan),
        judged,
        *observed.findings,
        unchecked_finding(axes.unchecked) if axes.unchecked else None,
        too_dark(observed.levels, observed.noise),
        *warnings_of(reasons, axes.modulation, observed.flicker),
        *motion_findings(pixels.motion),
    )
    return Decoding(
        matches,
        stack.texture,
        reasons,
        noise,
        axes.modulation,
        tuple(finding for finding in findings if finding),
        flicker=observed.flicker,
        motion=pixels.motion,
        only_axis=completion.measured.axis if completion else None,
        footprint_px2=pixels.coordinates.footprint_px2,
        smooth_px=hypot(smooth_error_px(plan.fringes), between_periods_px(plan, pixels.motion)),
        shifts=(shift_of(axes.unchecked),) if axes.unchecked else (),
        stripes=pixels.stripes,
    )


@dataclass(frozen=True)
class _DecodedPixels:
    """The coordinates of all pixels, and what only they tell."""

    coordinates: CoordinateMap
    """Without the motion of the devices."""
    cells_px: Floats32 | None
    """(H, W, 2): the centre of each pixel's cell, if all that is known is its cell; None if each pixel has its own
    coordinate."""
    motion: MotionEstimate | None
    """Of the devices."""
    stripes: FinestStripes | None
    """Contrast of the finest stripes."""


def _decode_pixels(
    images: CodeImages,
    samples: Samples,
    axes: CalibratedAxes,
    observed: Observations,
    projector_size: tuple[int, int],
) -> _DecodedPixels:
    """Decode all pixels and refine their coordinates; the words of the codes are dropped.

    Raises InputError if neighbours contradict each other all over the image, RefusalError if something moved between
    codes and fringes.
    """
    plan, is_anomalous = images.plan, bool(axes.anomalies)
    images, corrupted = repair_codes(images, observed.inconsistent)
    coordinates = decode_tiles(images, axes.decoders, observed.moved, corrupted)
    if (observed.moved is not None and not observed.code_shifts) or (is_anomalous and not plan.fringes):
        # Before interpolation between stripe edges, which makes coordinates smooth even where a bit is wrong.
        coordinates = mask_wrong_bits(plan, coordinates, observed.moved)
    undecided = coordinates.masked_as(MaskReason.UNDECIDED)
    coordinates = mask_stray_light(images, coordinates)
    check_roughness(plan, coordinates)
    coordinates = widen_by_roughness(plan, coordinates)
    images.release_contrasts()
    refined = refine_by_edges(images, coordinates, observed.noise, undecided)
    coordinates = refined or coordinates
    check_cycles(plan, coordinates.projector_px)
    if is_anomalous and observed.moved is None and plan.fringes:
        coordinates = mask_wrong_bits(plan, coordinates, None)
    stripes = finest_stripes(images, samples.scattered, coordinates)
    images.codes.clear()  # the frames alone tell of motion
    motion = observed.motion
    if halves := halves_of(images.frames.plan):
        motion = motion_between(halves, images, coordinates.projector_px, projector_size, motion)
    cells_px = None if refined or plan.fringes else coordinates.projector_px
    if motion is not None and motion.verdict is MotionVerdict.CORRECTABLE:
        coordinates = replace(coordinates, projector_px=motion.shift.subtracted_from(coordinates.projector_px))
    return _DecodedPixels(coordinates, cells_px, motion, stripes)
