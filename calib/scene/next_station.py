"""The next station that would help a calibration without a corner most, and what it would give.

Turns of the scene about the camera's axes are simulated: the points that a station would see after each are added to
the adjustment without an error, and the covariances compared (D-optimality; Atkinson and Donev, "Optimum experimental
designs", 1992).
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import Pose, rotation_about
from calib.geometry import radial_distortion as lens
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR
from calib.scene.adjustment import FEWEST_POINTS
from calib.scene.alignment import is_recognisable, surface_at
from calib.scene.problem import SceneFit, SceneProblem
from calib.scene.rigid_scene import ANYWHERE_PX, SceneObservations

TURN_DEG = 20.0
_INTRINSIC = np.array([CAMERA.start + k for k in range(3)] + [PROJECTOR.start + k for k in range(3)])


@dataclass(frozen=True)
class NextStation:
    """A turn of the scene before the newest station, or of the rig the other way round."""

    axis: int
    """0, 1, 2: the axis of the camera about which the scene turns: to the right, down, ahead."""
    turn_deg: float
    """By the right-hand rule: positive brings the top nearer, the front to the left, the right side down."""
    camera_focal: float
    """Relative standard deviation of the camera's focal length afterwards."""
    projector_focal: float
    """That of the projector's."""


def best_next_station(problem: SceneProblem, fit: SceneFit, covariance: Floats) -> NextStation | None:
    """The turn after which both devices' focal lengths and principal points would be known best; None if the newest
    station's points would be out of sight after any.

    `covariance` (21, 21): of the rig as it is known now, by whose ratio to that by the curvature alone the predicted
    ones are larger.
    """
    best, least = None, np.inf
    focal = [CAMERA.start, PROJECTOR.start]
    larger = np.sqrt(np.diag(covariance)[focal] / np.diag(problem.covariance(fit))[focal])
    scene, newest = fit.scene, fit.scene.stations[-1]
    middle = np.median(newest @ scene.points, axis=0)
    for axis in range(3):
        for turn_deg in (-TURN_DEG, TURN_DEG):
            rotation = rotation_about(np.radians(turn_deg) * np.eye(3)[axis])
            turned = Pose(rotation, middle - rotation @ middle) @ newest
            observations = _predicted(problem, fit, turned)
            if np.count_nonzero(observations.station == len(scene.stations)) < FEWEST_POINTS:
                continue
            predicted = replace(problem, observations=observations).evaluate(scene.with_station(turned))
            after = problem.covariance(predicted)
            spread = float(np.linalg.slogdet(after[np.ix_(_INTRINSIC, _INTRINSIC)])[1])
            if spread < least:
                camera, projector = (larger * np.sqrt(np.diag(after)[focal])).tolist()
                best, least = NextStation(axis, turn_deg, camera, projector), spread
    return best


def _predicted(problem: SceneProblem, fit: SceneFit, turned: Pose) -> SceneObservations:
    """All observations, and those of a further station at which `turned` puts the scene, X_station = R X_first + t."""
    known, matches, scene = problem.observations, problem.matches.matches, fit.scene
    first = np.flatnonzero(np.diff(known.point, prepend=-1))
    own = known[first]
    places = turned @ scene.points[own.point]
    motion = Pose.stack([turned @ pose.inverse() for pose in scene.stations])[own.station]
    _, tangents = surface_at(scene.rig, own.camera_px, own.projector_px, own.slope)
    tangents = motion.rotation @ tangents
    ahead = places[:, 2] > 0
    safe = np.where(ahead[:, None], places, [0.0, 0.0, 1.0])
    camera_px, by_place, _ = lens.project(scene.rig.camera, safe)
    projector_px, by_lit, _ = lens.project(scene.rig.projector, scene.rig.pose @ safe)
    warp, lit = by_place @ tangents, by_lit @ scene.rig.pose.rotation @ tangents
    visible = ahead & is_recognisable(warp)
    for pixels, used in ((camera_px, matches.camera_px), (projector_px, matches.projector_px)):
        visible &= ((pixels > used.min(axis=0)) & (pixels < used.max(axis=0))).all(axis=1)
    slope = lit[visible] @ np.linalg.inv(warp[visible])
    located = own.is_located[visible]
    new = SceneObservations(
        own.point[visible],
        np.full(np.count_nonzero(visible), len(scene.stations)),
        camera_px[visible],
        projector_px[visible],
        slope,
        own.sigma_px[visible],
        np.where(located, own.keypoint_px[visible], ANYWHERE_PX),
    )
    return SceneObservations.joined([known, new])
