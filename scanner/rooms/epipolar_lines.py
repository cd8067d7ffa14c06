"""Whether captures were made by one rig: their matches lie on its epipolar lines, whatever they show.

Surfaces are a weaker criterion: a changed rig bends them, but perhaps not beyond other errors, and they may then be
taken for a part of the room.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Matches, intersect_rays
from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints

_TILE = 16  # pixels
_FEWEST_IN_A_TILE = 30
_FAR_OFF = 3.0  # sigmas of the median tile
_LEAST_PX = 0.03  # smooth errors of a decoder, and slight deformation of a carried rig
_DEVIATIONS_OF_MEDIAN = 1.2533 * SIGMA_PER_MEDIAN  # standard error of a median · √N, in median deviations from it

CHANGED_RIG = FindingKind(
    "changed-rig",
    "A station is left out: another rig, or a changed one, made it.",
    "Camera, projector, zoom and focus have to stay as they are between stations: take it again.",
    ("off_px", "turn_deg"),
)


@dataclass(frozen=True, eq=False)
class LineOffsets:
    """By how much a capture's matches are off the epipolar lines of a rig, in projector px, as medians over tiles of
    the camera's picture (T,) with their standard errors.
    """

    median_px: Floats
    error_px: Floats

    @property
    def usual_px(self) -> float:
        """Root mean square over the tiles; infinite if there are none."""
        return float(np.sqrt(np.mean(self.median_px**2))) if len(self.median_px) else np.inf

    def deviation_px(self, usual_px: float) -> float | None:
        """By how much the capture is off, if by more than noise and `usual_px`, as the rig's own captures are."""
        if len(self.median_px) == 0:
            return None
        off = np.abs(self.median_px)
        return float(np.median(off)) if np.median(off / np.hypot(self.error_px, usual_px)) > _FAR_OFF else None


def line_offsets(matches: Matches, calibration: Calibration) -> LineOffsets:
    """Of one capture."""
    met = intersect_rays(matches.camera_px, matches.projector_px, calibration)
    camera_px, off = matches.camera_px[met.in_front], met.residual_px[met.in_front]
    column, row = np.rint(camera_px).astype(np.int64).T // _TILE
    tile = row * (calibration.camera.width // _TILE + 1) + column
    _, own, count = np.unique(tile, return_inverse=True, return_counts=True)
    median = _medians(off, own, count)
    error = _DEVIATIONS_OF_MEDIAN * _medians(np.abs(off - median[own]), own, count) / np.sqrt(count)
    enough = count >= _FEWEST_IN_A_TILE
    return LineOffsets(median[enough], error[enough])


def usual_px(offsets: Sequence[LineOffsets]) -> float:
    """Root mean square over the tiles; infinite without any."""
    return max(_LEAST_PX, sorted(offset.usual_px for offset in offsets)[(len(offsets) - 1) // 2])


def of_another_rig(captures: Sequence[Matches], calibration: Calibration) -> dict[int, Finding]:
    """Which captures another rig made than most of them, by number, and what shows it.

    `calibration`: of the rig, as most of the captures, or the corners that some of them show, have it.
    """
    offsets = [line_offsets(capture, calibration) for capture in captures]
    usual = usual_px(offsets)
    far = {k: offset.deviation_px(usual) for k, offset in enumerate(offsets)}
    return {
        k: Finding(
            CHANGED_RIG,
            Severity.WARNING,
            f"its matches are {px:.2g} projector px off the epipolar lines of the others' rig",
            data={"off_px": px},
        )
        for k, px in far.items()
        if px is not None
    }


def _medians(values: Floats, group: Ints, count: Ints) -> Floats:
    """Of each group 0 … G − 1 of the values (N,), (G,); `count` (G,) are their sizes. Of two middle ones the upper."""
    order = np.lexsort((values, group))
    medians: Floats = values[order][np.cumsum(count) - count + count // 2]
    return medians
