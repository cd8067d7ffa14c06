"""Recognises degenerate configurations: why a view of a corner calibrates badly.

These reasons explain a refusal and what to change. The decision itself rests on covariance and residuals.
"""

import numpy as np

from calib.estimation import Cells
from calib.geometry import FACES, Matches, homography_between, mapped
from calib.refinement import State, Straightened
from calib.refusal import Wording

_NAMES = ("first", "second", "third")
# Limits below which an angle or a share is named as a reason.
_GRAZING_DEG = 8.0
_FORWARD_DEG = 12.0
_SMALL_EXTENT, _THIN = 0.15, 0.01
_SHORT_BASELINE = 0.03  # of the distance to the vertex
# Largest residual of two faces under a common homography at which they carry no measurable depth.
_ONE_PLANE_PX, _ONE_PLANE_SIGMAS = 0.1, 2.0


def one_plane(cells: Cells, straightened: Straightened, words: Wording) -> str | None:
    """A sentence on faces that share one homography, within noise and the decoder's systematic errors; or None."""
    limit_px = _ONE_PLANE_PX + _ONE_PLANE_SIGMAS * float(np.median(cells.sigma_px))
    together = [pair for pair in ((0, 1), (1, 2), (2, 0)) if _off_one_plane(straightened.matches, *pair) < limit_px]
    if len(together) > 1:
        return f"all lie in one plane (a flat wall), or {words.both} are one and the same: there is no depth"
    if together:
        i, j = together[0]
        return f"the {_NAMES[i]} and the {_NAMES[j]} lie in one plane, so only two planes are seen"
    return None


def reasons_in_images(cells: Cells) -> list[str]:
    """Reasons visible in the images alone: faces that cover too little of the picture."""
    reasons = []
    whole = np.linalg.norm(np.ptp(cells.camera_px, axis=0))
    for face in FACES:
        on_face = cells.camera_px[cells.plane == face]
        extent = np.linalg.norm(np.ptp(on_face, axis=0)) / whole
        thickness = np.sqrt(np.linalg.eigvalsh(np.cov(on_face.T))[0]) / whole
        if extent < _SMALL_EXTENT:
            reasons.append(f"the {_NAMES[face]} face is small: {100 * extent:.0f} % of the picture of the corner")
        elif thickness < _THIN:
            reasons.append(f"the {_NAMES[face]} face is seen as a line: it passes nearly through the camera's centre")
    return reasons


def reasons_in_space(state: State, capture: int, words: Wording) -> list[str]:
    """Reasons in the geometry of corner, camera and projector, according to the present solution."""
    reasons = []
    vertex, pose = state.corner(capture).vertex, state.pose_of(capture)
    normals = state.normals(capture)
    second = pose.inverse().translation
    for device, centre in ((words.first, np.zeros(3)), (words.second, second)):
        slant = np.degrees(
            np.arcsin(np.clip(np.abs(normals @ (vertex - centre)) / np.linalg.norm(vertex - centre), 0, 1))
        )
        reasons += [
            f"the {_NAMES[face]} face is seen at a slant of only {slant[face]:.0f}° from {device}: "
            f"the face passes nearly through its centre"
            for face in FACES
            if slant[face] < _GRAZING_DEG
        ]
    distance = float(np.linalg.norm(vertex))
    ahead = np.degrees(np.arccos(np.clip(abs(second @ vertex) / (pose.distance * distance), 0, 1)))
    if ahead < _FORWARD_DEG:
        reasons.append(f"{words.both} are behind one another ({ahead:.0f}° from the line to the corner)")
    if pose.distance / distance < _SHORT_BASELINE:
        reasons.append(
            f"{words.both} are only {100 * pose.distance / distance:.1f} % of the distance to the corner apart"
        )
    return reasons


def _off_one_plane(matches: Matches, i: int, j: int) -> float:
    """Median deviation in projector px from one homography for two faces."""
    chosen = np.isin(matches.labels, (i, j))
    camera_px, projector_px = matches.camera_px[chosen], matches.projector_px[chosen]
    homography = homography_between(camera_px, projector_px)
    return float(np.median(np.linalg.norm(mapped(homography, camera_px) - projector_px, axis=1)))
