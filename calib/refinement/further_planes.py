"""Further planes that are parallel or perpendicular to the corner's faces: additional constraints, with tests.

The top of a box is parallel to the floor, the front of a cupboard to a wall. Such a plane is aligned with the corner
within about half a degree, and its homography is another measurement of the rig. Candidates are selected with a
solution that does not use them. A plane is rejected if it then strains the angles, or if the rig explains its cells
much worse than those of the faces: where something moved during the capture, wrong matches may follow a homography that
is no plane of the scene.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.estimation import Cells, into_cells, joined
from calib.geometry import FACES, Matches, nearest_depths, unproject
from calib.numerics import Floats, Ints
from calib.refinement.likelihood import CornerFit, CornerProblem
from calib.refinement.parameters import FurtherPlane, State

SIGMA_DEG = 0.5  # alignment of furniture with walls, and squareness of boxes
_CANDIDATE_DEG = 2.0
_LEAST_MATCHES, _SAMPLE = 400, 200_000
_TENSION = 3.0  # sigmas of a tilt
# Mean square residual relative to that of the faces alone: true planes reach up to 2, wrong ones 6 and more.
_MOST_OFF = 4.0


def with_further_planes(
    captures: Sequence[Cells], matches: Sequence[Matches], planes: Sequence[Ints], state: State
) -> tuple[list[Cells], State]:
    """Add the cells of further planes, labelled 3 and up, to the captures, and those planes to the state.

    `planes`: for each capture, the plane of each match (N,), −1 for none. Planes that contain faces are skipped, and so
    are those of a capture taken from the place of an earlier one, which sees the same planes again.
    """
    extended, corners = [], []
    for i, (cells, points, label) in enumerate(zip(captures, matches, planes, strict=True)):
        corner = state.corners[i]
        seen_before = any(state.same_place(i, j) for j in range(i))
        for candidate in () if seen_before else _candidates(points, label):
            part = into_cells(points, (candidate,), label)
            plane = _square_plane(part, state, i)
            if plane is not None:
                number = len(FACES) + len(corner.planes)
                corner = replace(corner, planes=(*corner.planes, plane))
                cells = joined(cells, replace(part, plane=np.full(len(part), number, np.int32)))
        extended.append(cells)
        corners.append(corner)
    return extended, replace(state, corners=tuple(corners))


def oblique_planes(state: State) -> list[tuple[int, int]]:
    """Return (capture, index among its further planes) of planes that are not parallel or perpendicular to a face."""
    return [
        (i, j)
        for i, corner in enumerate(state.corners)
        for j, plane in enumerate(corner.planes)
        if np.any(np.abs(plane.tilt) > _TENSION * np.array(plane.tilt_sigma))
    ]


def unexplained(problem: CornerProblem, fit: CornerFit, of_faces: float) -> list[tuple[int, int]]:
    """Return the worst-fitting plane, as `oblique_planes` does, if it fits much worse than the faces alone.

    `of_faces`: the mean square residual of the faces.
    """
    worst, planes = _MOST_OFF * of_faces, []
    of_captures = zip(problem.captures, fit.residuals, problem.variances, strict=True)
    for i, (cells, residual, variance) in enumerate(of_captures):
        for plane in range(len(FACES), len(FACES) + len(fit.state.corners[i].planes)):
            off = mean_square(residual[cells.plane == plane], variance[cells.plane == plane])
            if off > worst:
                worst, planes = off, [(i, plane - len(FACES))]
    return planes


def mean_square(residual: Floats, variance: Floats) -> float:
    """Return the mean square of residuals (M, 2) relative to the variance (M,) of a coordinate."""
    return float(np.mean(residual**2 / variance[:, None]))


def without(captures: Sequence[Cells], state: State, planes: list[tuple[int, int]]) -> tuple[list[Cells], State]:
    """Remove some of the further planes from captures and state."""
    reduced, corners = [], []
    for i, (cells, corner) in enumerate(zip(captures, state.corners, strict=True)):
        kept = [j for j in range(len(corner.planes)) if (i, j) not in planes]
        number = np.full(len(FACES) + len(corner.planes), -1, np.int32)
        number[[*FACES, *(len(FACES) + j for j in kept)]] = np.arange(len(FACES) + len(kept))
        renumbered = replace(cells, plane=number[cells.plane])
        reduced.append(renumbered[renumbered.plane >= 0])
        corners.append(replace(corner, planes=tuple(corner.planes[j] for j in kept)))
    return reduced, replace(state, corners=tuple(corners))


def _candidates(matches: Matches, plane: Ints) -> list[int]:
    """Return planes with enough matches of which none is on a face, by a sample."""
    step = len(plane) // _SAMPLE | 1  # odd: columns of an image take turns
    some, face = plane[::step], matches.labels[::step]
    size = max(int(some.max(initial=-1)), 0) + 1
    counts, on_faces = (np.bincount(some[of], minlength=size) for of in (some >= 0, (some >= 0) & (face >= 0)))
    return [int(label) for label in np.flatnonzero((step * counts >= _LEAST_MATCHES) & (on_faces == 0))]


def _square_plane(cells: Cells, state: State, capture: int) -> FurtherPlane | None:
    """Fit a plane to the cells' points; None unless it is parallel or perpendicular to a face."""
    corner = state.corners[capture]
    rays, _ = unproject(state.camera, cells.camera_px)
    depth = depths(state, rays, cells.projector_px)
    if not np.all(depth > 0):
        return None
    points = rays * depth[:, None]
    centre = points.mean(axis=0)
    normal: Floats = corner.frame @ np.linalg.svd(points - centre)[2][2]
    angles = np.degrees(np.arcsin(np.minimum(np.abs(normal), 1.0)))  # from each face: 90 parallel, 0 perpendicular
    parallel, across = int(np.argmax(angles)), int(np.argmin(angles))
    sigma = float(np.radians(SIGMA_DEG))
    if angles[parallel] > 90 - _CANDIDATE_DEG:
        axes, sigmas = np.roll(np.eye(3), -parallel, axis=0), (sigma, sigma)
    elif angles[across] < _CANDIDATE_DEG:
        level = normal.copy()
        level[across] = 0.0
        level /= np.linalg.norm(level)
        upright = np.eye(3)[across]
        axes, sigmas = np.stack([level, np.cross(upright, level), upright]), (np.inf, sigma)
    else:
        return None
    if normal @ axes[0] < 0:
        normal = -normal
    tilt = axes[1:] @ normal / (axes[0] @ normal)
    height = float((normal @ corner.frame) @ (centre - corner.vertex))
    return FurtherPlane(axes, tilt, height, sigmas)


def depths(state: State, rays: Floats, projector_px: Floats) -> Floats:
    """Return depths (N,) along the camera's rays (N, 3) at which they come nearest to the projector's rays."""
    directions, _ = unproject(state.projector, projector_px)
    return nearest_depths(state.pose.rotate(rays), directions, state.pose.translation)[0]
