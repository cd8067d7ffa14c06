"""The uncertainty of depth: its standard deviation over the camera's image, and the cost of an assumption; of several
captures of one rig, the contribution of each, and their common cloud.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.diagnostics import Uncertainty
from calib.geometry import Matches, Size, intersect
from calib.pointcloud import NONE
from calib.refinement import CAMERA, PROJECTOR
from calib.self_calibration import SelfCalibration
from scanner.quantities import plain
from scanner.rendering import cells_over, one_in_cells, render, standard_views
from scanner.reporting import maps
from scanner.reporting.contents import ReportInput
from scanner.reporting.sections import PageImage, ScaledMap, picture, view

# Sigmas vary smoothly over the image, so this many samples suffice for the map.
_SAMPLES = 10_000
_VIEW_SIZE = (960, 640)
_UP = np.array([0.0, 0.0, 1.0])
_CAPTIONS = {
    "oblique": "All captures in one, from the side and above.",
    "top": "From above: a wall that appears twice would mean that the captures do not fit.",
}


@dataclass(frozen=True)
class PointSigmas:
    """`map` over the camera's image of the sigma of depth; `median_percent` of a point's depth."""

    map: ScaledMap
    median_percent: float


def point_sigmas(report: ReportInput) -> PointSigmas | None:
    """The map of the sigmas of depth; None where the method knows none."""
    solution = report.solution
    if solution is None or solution.uncertainty is None:
        return None
    percent = _relative_sigmas(report.sample, solution, solution.uncertainty, report.metadata.camera_size)
    known = percent[np.isfinite(percent)]
    if not len(known):
        return None
    painted, scale = maps.sigma_map(percent)
    alt = "standard deviation of depth over the camera's image"
    return PointSigmas(ScaledMap(picture(painted, alt), scale), float(np.median(known)))


def _relative_sigmas(
    matches: Matches, solution: SelfCalibration, uncertainty: Uncertainty, camera_size: Size
) -> NDArray[np.float32]:
    """Return the sigma of depth of one match per cell of a coarse grid over the image, in per cent of its depth; NaN
    for none.
    """
    drawn = one_in_cells(matches.camera_px, *cells_over(camera_size, _SAMPLES))
    known = np.nonzero(drawn != NONE)
    sample = matches[drawn[known]]
    met = intersect(sample, solution.calibration)
    relative = np.where(met.in_front, uncertainty.of_points(sample)[:, 2] / met.points[:, 2], np.nan)
    grid = np.full(drawn.shape, np.nan, dtype=np.float32)
    grid[known] = 100 * relative
    return grid


_SHIFT_PX = 10.0


@dataclass(frozen=True)
class PrincipalPointEffect:
    """The effect of the assumption: `sentences` for a person, none without one; `per_px`: relative change of the larger
    focal length.
    """

    sentences: tuple[str, ...] = ()
    per_px: float = 0.0


def effect_of_principal_point(solution: SelfCalibration | None) -> PrincipalPointEffect:
    """Return the effect of an error in a principal point that was taken as known."""
    if solution is None or solution.uncertainty is None or solution.uncertainty.by_principal_point is None:
        return PrincipalPointEffect()
    by_pixel = solution.uncertainty.by_principal_point[[CAMERA.start, PROJECTOR.start]]  # of log f
    effects = [
        f"{_SHIFT_PX:g} px in {axis} would move the camera's focal length by {plain(100 * camera, 2, signed=True)} % "
        f"and the projector's by {plain(100 * projector, 2, signed=True)} %"
        for axis, (camera, projector) in zip("xy", _SHIFT_PX * by_pixel.T, strict=True)
    ]
    sentence = f"The camera's principal point was taken as known. If it is elsewhere: {'; '.join(effects)}."
    return PrincipalPointEffect((sentence,), float(np.linalg.norm(by_pixel, axis=1).max()))


@dataclass(frozen=True)
class JointRow:
    """A capture as text: address of its report, matches, residual, decoder's noise and points; '–' for missing ones."""

    name: str
    report: str
    cells: tuple[str, ...]


def joint_rows(report: ReportInput) -> tuple[JointRow, ...]:
    """The captures that were calibrated together; none for a capture alone."""
    return tuple(
        JointRow(
            row.name,
            row.report,
            (
                f"{row.matches:,}",
                "–" if row.residual_px is None else f"{row.residual_px:.3f} px",
                "–" if row.statistics is None else f"{row.statistics.decoder_px:.3f} px",
                "–" if row.statistics is None else f"{row.statistics.kept:,}",
            ),
        )
        for row in report.joint.rows
    )


def merged_views(report: ReportInput) -> tuple[PageImage, ...]:
    """Pictures of the merged cloud, seen along the floor's diagonal into the corner, and from above."""
    cloud = report.joint.merged
    if cloud is None or not len(cloud.points):
        return ()
    up = _UP * np.sign(np.median(cloud.points[:, 2])) if np.median(cloud.points[:, 2]) else _UP
    middle = np.median(cloud.points.astype(np.float64), axis=0)
    into_corner = -np.array([middle[0], middle[1], 0.0])
    views = standard_views(into_corner, up)
    return tuple(
        view(render(cloud, views[name], _VIEW_SIZE, []), name, "the merged point cloud", caption)
        for name, caption in _CAPTIONS.items()
    )
