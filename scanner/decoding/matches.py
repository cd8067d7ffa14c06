"""Collect the matches of the kept pixels, and the reasons why the others are masked.

A sequence that varies along one axis leaves the other coordinate to a calibration. The camera ray and the projector's
stripe plane determine the point: they cross on the pixel's epipolar line. No redundancy is left to check the
calibration.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Matches, cross_epipolar_lines
from calib.numerics import STRIP_ROWS, Bools, Floats, Floats32, Image, compiled, in_slices
from scanner.decoding.codes.gray_code import CellMatches, average_cells
from scanner.decoding.coordinates.axis_decoder import EDGE_PX, mask_outside
from scanner.decoding.coordinates.coordinate_map import CoordinateMap, small_patches
from scanner.decoding.map_checks import check_maps
from scanner.decoding.mask_reasons import MaskReason, Reasons
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.patterns import Axis

# At 6° between epipolar line and stripe, calibration errors count ten times.
_LEAST_SINE = 0.1

ONE_AXIS = FindingKind(
    "one-axis",
    "Patterns varied along one axis only; the other coordinate follows from the calibration, which nothing checks.",
    "Project patterns along the other axis as well to check the calibration.",
)


def one_axis_finding(axis: Axis) -> Finding:
    """Return the note on the only coordinate that was measured."""
    message = f"only the {axis} coordinate was measured, so nothing checks whether the calibration fits."
    return Finding(ONE_AXIS, Severity.NOTE, message)


@dataclass(frozen=True)
class OneAxis:
    """Two axes, of which a calibration determines one."""

    measured: AxisPlan
    """By the patterns."""
    derived: AxisPlan
    """By the calibration."""
    calibration: Calibration
    """Of the rig."""

    @property
    def _axis(self) -> int:
        return 0 if self.measured.axis == "x" else 1

    def complete(self, maps: CoordinateMap) -> CoordinateMap:
        """Return the map with the other coordinate, and with variances and reasons that follow from it.

        The variance becomes that along the epipolar line, which determines the uncertainty of a point.
        """
        whole = replace(
            maps, projector_px=maps.projector_px.copy(), variance=maps.variance.copy(), reason=maps.reason.copy()
        )

        def fill(rows: slice) -> None:
            reason, values, variance = whole.reason[rows], whole.projector_px[rows], whole.variance[rows]
            row, column = np.nonzero(reason == np.uint8(MaskReason.KEPT))
            camera_px = np.stack([column, row + rows.start], axis=1).astype(np.float64)
            known_px = values[row, column, self._axis].astype(np.float64)
            crossings = cross_epipolar_lines(camera_px, known_px, self._axis, self.calibration)
            crossing = crossings.projector_px[:, 1 - self._axis]
            inside = np.abs(crossing - (self.derived.length - 1) / 2) <= self.derived.length / 2 + EDGE_PX
            conditions = [crossings.sine < _LEAST_SINE, ~(crossings.in_front & inside)]
            masks = [np.uint8(MaskReason.ALONG_EPIPOLAR_LINE), np.uint8(MaskReason.OUTSIDE)]
            reason[row, column] = np.select(conditions, masks, np.uint8(MaskReason.KEPT))
            values[row, column, 1 - self._axis] = crossing
            variance[row, column] /= np.maximum(crossings.sine, _LEAST_SINE) ** 2

        in_slices(maps.reason.shape[0], STRIP_ROWS, fill)
        return whole

    def average_stripes(self, kept: Bools, maps: CoordinateMap, brightness: Image) -> CellMatches:
        """Average the pixels as `average_cells` does, with stripes cut into square cells.

        They are cut along the coordinate that was filled in; it is computed again at the centre of each cell's pixels.
        """
        cell, cut = np.float32(self.measured.cell), maps.projector_px.copy()
        along = cut[..., 1 - self._axis]
        # Noise may have carried a coordinate beyond the first pixel.
        number = np.maximum(np.floor((along[kept] + np.float32(0.5)) / cell), 0)
        along[kept] = number * cell + (cell - 1) / 2
        cells = average_cells(kept, cut, cut, maps.variance, brightness)
        known_px = cells.projector_px[:, self._axis]
        crossings = cross_epipolar_lines(cells.camera_px, known_px, self._axis, self.calibration)
        there = crossings.in_front
        return CellMatches(cells.camera_px[there], crossings.projector_px[there], cells.variance[there], cells.rejected)


def one_axis(plan: SequencePlan, calibration: Calibration | None) -> OneAxis | None:
    """Return the completion of a sequence that measures one axis; None if it measures both."""
    if plan.only_axis is None or calibration is None:
        return None
    return OneAxis(plan.only_axis, plan.y if plan.only_axis is plan.x else plan.x, calibration)


def collect_matches(
    plan: SequencePlan, maps: CoordinateMap, cells_px: Floats32 | None, white: Image, completion: OneAxis | None
) -> tuple[Matches, Reasons]:
    """Return the matches of the pixels that remain, and for all pixels (H, W) the mask reason. Raises InputError.

    `cells_px`: (H, W, 2) the centre of each pixel's cell, for one match per cell of the codes; None if each pixel has
    its own coordinate. `white`: (H, W) grey.
    """
    # Interpolation between blurred edges, or a motion that was taken back, may carry coordinates beyond the border.
    maps = replace(maps, reason=maps.reason.copy())
    for number, axis in enumerate(plan.axes):
        mask_outside(axis, maps.projector_px.reshape(-1, 2)[:, number], maps.reason.reshape(-1))
    if completion:
        # Before the calibration masks pixels, which would be its error rather than the frames'.
        check_maps(plan, maps)
        maps = completion.complete(maps)
    kept = maps.masked_as(MaskReason.KEPT)
    if cells_px is None:
        maps = maps.masked(small_patches(kept), MaskReason.ISOLATED)
        matches = _pixel_matches(maps)
    else:
        if completion:
            cells = completion.average_stripes(kept, maps, white)
        else:
            cells = average_cells(kept, cells_px, maps.projector_px, maps.variance, white)
        maps = maps.masked(cells.rejected, MaskReason.ISOLATED)
        matches = Matches(cells.camera_px, cells.projector_px, sigma_px=np.sqrt(cells.variance))
    if not completion:
        check_maps(plan, maps)
    return matches, maps.reason


def _pixel_matches(maps: CoordinateMap) -> Matches:
    """Return the matches of the kept pixels, row by row.

    Single precision is exact for camera pixels, and is the precision of the maps.
    """
    first = np.append(0, np.cumsum(np.count_nonzero(maps.masked_as(MaskReason.KEPT), axis=1)))
    camera_px, projector_px = np.empty((2, first[-1], 2), np.float32)
    sigma_px = np.empty(first[-1], np.float32)

    def gather(rows: slice) -> None:
        own = slice(first[rows.start], first[rows.stop])
        part = maps.reason[rows], maps.projector_px[rows], maps.variance[rows]
        _gather(*part, rows.start, camera_px[own], projector_px[own], sigma_px[own])

    in_slices(len(maps.reason), STRIP_ROWS, gather)
    return Matches(cast(Floats, camera_px), cast(Floats, projector_px), sigma_px=cast(Floats, sigma_px))


@compiled
def _gather(
    reason: Reasons,
    px: Floats32,
    variance: Floats32,
    first_row: int,
    camera_px: Floats32,
    projector_px: Floats32,
    sigma_px: Floats32,
) -> None:
    """Write the matches of the kept pixels in some rows of the image, from their first row on."""
    height, width = reason.shape
    match = 0
    for row in range(height):
        for column in range(width):
            if reason[row, column] == 0:
                camera_px[match, 0], camera_px[match, 1] = column, first_row + row
                projector_px[match, 0], projector_px[match, 1] = px[row, column, 0], px[row, column, 1]
                sigma_px[match] = np.sqrt(variance[row, column])
                match += 1
