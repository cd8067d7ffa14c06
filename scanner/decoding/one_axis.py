"""Decode a sequence that varies along one axis only: the other coordinate of each pixel comes from a calibration.

The camera ray and the projector's stripe plane determine the point: they cross on the pixel's epipolar line. No
redundancy is left to check the calibration.
"""

from dataclasses import dataclass

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, cross_epipolar_lines
from calib.numerics import STRIP_ROWS, Bools, Image, in_slices
from scanner.decoding.axis_decoder import EDGE_PX
from scanner.decoding.codes.code_cells import CellMatches, average_cells
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import MaskReason
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

    def complete(self, maps: Maps) -> None:
        """Fill in the other coordinate, and update variances and reasons; in place.

        The variance becomes that along the epipolar line, which determines the uncertainty of a point.
        """

        def fill(rows: slice) -> None:
            reason, values, variance = maps.reason[rows], maps.projector_px[rows], maps.variance[rows]
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

    def average_stripes(self, kept: Bools, maps: Maps, brightness: Image) -> CellMatches:
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
