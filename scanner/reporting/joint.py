"""Several captures of one rig on one page: the contribution of each, and their common cloud."""

from dataclasses import dataclass

import numpy as np

from scanner.rendering import render, standard_views
from scanner.reporting.contents import ReportInput
from scanner.reporting.sections import PageImage, view

_VIEW_SIZE = (960, 640)
_UP = np.array([0.0, 0.0, 1.0])
_CAPTIONS = {
    "oblique": "All captures in one, from the side and above.",
    "top": "From above: a wall that appears twice would mean that the captures do not fit.",
}


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
