"""The next best view: where to take one more capture of the same corner, and how much it would help.

Candidate poses of the rig around the corner are tried. The information of a predicted capture, with the noise of the
existing ones, is added to theirs; the inverse of the sum is the resulting covariance.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy

from calib.estimation import Cells
from calib.geometry import FACES, PER_POSE, depths_on_planes, unproject
from calib.numerics import Floats, covariance_of, inverse_of
from calib.refinement import CAMERA, CornerProblem, Knowledge, PlacedCorner, Refinement, State, predict

_TURNS_DEG = (-25.0, 0.0, 25.0)
_DISTANCES = (0.75, 1.0, 1.3)
_COLUMNS = 16
_LEAST_SLANT = 0.12  # sine of the angle between a device's view of the vertex and a face
_LEAST_SHARE = 0.03  # of the rays that both devices see, on each face


@dataclass(frozen=True)
class NextView:
    """A capture that would help."""

    right_deg: float
    """By how much the rig moves around the corner to the right; negative: to the left."""
    up_deg: float
    """The same upwards; negative: downwards."""
    distance: float
    """Its distance then over its present one."""
    sigma: float
    """What the relative sigma of the camera's focal length becomes."""
    step: Floats
    """Displacement of the camera in its present frame (right, down, forward), in baselines, (3,)."""

    @property
    def words(self) -> str:
        """Directions for a person who stands behind the camera."""
        moves = [
            f"{abs(angle):.0f}° to the {ways[angle < 0]}" if name == "right" else f"{abs(angle):.0f}° {ways[angle < 0]}"
            for name, angle, ways in (
                ("right", self.right_deg, ("right", "left")),
                ("up", self.up_deg, ("upwards", "downwards")),
            )
            if angle
        ]
        if self.distance != 1.0:
            moves.append(
                f"{'closer, to' if self.distance < 1 else 'farther away, to'} {self.distance:g} × the distance"
            )
        return " and ".join([", ".join(moves[:-1]), moves[-1]] if len(moves) > 1 else moves)


def best_next_view(refinement: Refinement, knowledge: Knowledge) -> NextView | None:
    """The most useful move from the last capture; None if no candidate shows all three faces to both devices."""
    state = refinement.fit.state
    cells, level = refinement.captures[-1], refinement.noise[-1]
    variance = float(np.median(level.variances(cells)) * len(cells))
    # The gain is computed from curvature alone. Smooth errors are a factor, as further captures have them too.
    present = covariance_of(refinement.fit.information, refinement.prior.free)
    beyond = float(np.sqrt(refinement.covariance[CAMERA.start, CAMERA.start] / present[CAMERA.start, CAMERA.start]))
    best: NextView | None = None
    for right, up, distance in product(_TURNS_DEG, _TURNS_DEG, _DISTANCES):
        if right == up == 0:
            continue
        corner = moved_corner(state.corners[-1], right, up, distance)
        visible = _seen(replace(state, corners=(*state.corners, corner)), knowledge)
        if visible is None:
            continue
        sigma = beyond * _sigma_with(refinement, present, corner, visible, variance / len(visible), knowledge)
        if best is None or sigma < best.sigma:
            best = NextView(right, up, distance, sigma, step_taken(state.corners[-1], right, up, distance))
    return best


def moved_corner(corner: PlacedCorner, right_deg: float, up_deg: float, distance: float) -> PlacedCorner:
    """The corner's pose after the rig moved around it: relative to the rig, the corner turns the other way."""
    turn = _turn(right_deg, up_deg)
    return replace(corner, frame=corner.frame @ turn.T, vertex=distance * corner.vertex, planes=())


def _turn(right_deg: float, up_deg: float) -> Floats:
    """Camera's axes: x right, y down. Walking to the right turns the corner about y, climbing turns it about x."""
    return scipy.spatial.transform.Rotation.from_euler("yx", [right_deg, up_deg], degrees=True).as_matrix()


def step_taken(corner: PlacedCorner, right_deg: float, up_deg: float, distance: float) -> Floats:
    """The new camera centre in the present frame, the zero of X = vertex + turn (X_now − vertex_now)."""
    return corner.vertex - distance * _turn(right_deg, up_deg).T @ corner.vertex


def _seen(state: State, knowledge: Knowledge) -> Cells | None:
    """Predicted cells of the last capture's faces that both devices see; None if a face is hardly visible."""
    capture = len(state.corners) - 1
    width, height = knowledge.camera_size
    rows = max(2, round(_COLUMNS * height / width))
    x, y = np.meshgrid(np.linspace(0, width - 1, _COLUMNS), np.linspace(0, height - 1, rows))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    rays, _ = unproject(state.camera, pixels)
    normals = state.normals(capture)
    with np.errstate(divide="ignore", invalid="ignore"):
        depths = depths_on_planes(rays[:, None], normals, state.corners[capture].vertex)
    slants = _slants(state, capture)
    if np.any(slants * np.sign(_slants(state, capture - 1)) < _LEAST_SLANT):
        return None  # the rig would stand in a wall, or see a face of the box from within
    # From inside, the nearest wall is visible; of a box from outside, it is the farthest plane.
    inside = bool(np.all(slants > 0))
    depths = np.where(depths > 0, depths, np.inf if inside else -np.inf)
    face = (np.argmin(depths, axis=1) if inside else np.argmax(depths, axis=1)).astype(np.int32)
    predicted, _, both = predict(state, pixels, face, capture)
    limits = np.array(knowledge.projector_size) - 1
    with np.errstate(invalid="ignore"):
        lit = np.all((predicted >= 0) & (predicted <= limits), axis=1) & np.all(both > 0, axis=1)
    lit &= np.isfinite(predicted).all(axis=1)
    if np.bincount(face[lit], minlength=len(FACES)).min() < _LEAST_SHARE * len(face):
        return None
    ones = np.ones(int(lit.sum()))
    return Cells(pixels[lit], predicted[lit], face[lit], ones, ones, 1.0, 0.0)


def _slants(state: State, capture: int) -> Floats:
    """Sines of the angles at which camera and projector see each face, (2, 3); negative from the side without legs."""
    vertex = state.corners[capture].vertex
    centres = np.stack([np.zeros(3), state.pose.inverse().translation])
    directions = centres - vertex
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions @ state.normals(capture).T


def _sigma_with(
    refinement: Refinement, present: Floats, corner: PlacedCorner, cells: Cells, variance: float, knowledge: Knowledge
) -> float:
    """Relative sigma of the camera's focal length with a further capture of `cells`; `present`: the covariance by
    curvature, without smooth errors and the curved valley.
    """
    state = refinement.fit.state
    alone = replace(state, corners=(corner,), off_square=state.off_square[corner.shape][None])
    alone = replace(alone, corners=(replace(corner, shape=0),))
    prior = knowledge.prior(alone)
    flat = replace(prior, sigma=np.where(prior.free, np.inf, 0.0), rig=None)
    new = CornerProblem.of([cells], flat, [np.full(len(cells), variance)]).evaluate(alone).information
    kept = np.flatnonzero(prior.free)
    shared = kept[kept < alone.size - PER_POSE]
    # Present information on the shared columns. With a second capture the valley is short, so curvature suffices.
    known = state.columns(len(refinement.captures) - 1)[shared]
    total = new.copy()
    total[np.ix_(shared, shared)] += inverse_of(present[np.ix_(known, known)])
    return float(np.sqrt(covariance_of(total, prior.free)[CAMERA.start, CAMERA.start]))
