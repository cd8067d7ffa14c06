"""Starts of a calibration without a corner, from a guess of nothing.

The fundamental matrix is the same in all stations of an unchanged rig. With trial focal lengths it becomes the
essential matrix (Hartley & Zisserman, 2nd ed., chapter 9), which gives the rig's pose, and with it the points of each
station in one unit, the baseline. Matching keypoints of two stations then agree by a rigid motion only near the truth:
how many do, and how well, is the score of a trial.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.closed_form import intrinsic_matrices
from calib.geometry import IDENTITY, Pose, depths_of_rays, homogeneous
from calib.numerics import Bools, Floats, Ints, at_random
from calib.refinement import State, without_lens
from calib.registration import fit_rigid_motion
from calib.scene.views import MatchedView, SceneView, some_matches

_MATCHES = 4000  # of each view, for the fundamental matrix
_ON_LINE_PX = 1.0
_FOCALS = np.geomspace(0.8, 3.2, 8)  # in image widths
_LENS_SHIFTS = (0.5, 1.0, 0.0)  # heights of the projector's principal point, in picture heights
_PAIRS = 12  # of views with most matching keypoints, by which trials are judged
_JUDGING = 120  # keypoints of such a pair
_FEWEST = 8  # keypoints of a pair that agree
_WITHIN = 0.02, 0.01, 0.005  # of the distance: agreement of two points, ever closer
_COMPATIBLE = 0.03  # agreement of distances between points
_SEEDS = 3


@dataclass(frozen=True, eq=False)
class SceneStart:
    """A trial: devices and relative pose, and what two stations share under it."""

    rig: State
    score: float
    motions: Mapping[tuple[int, int], tuple[Pose, Bools]]
    """By pairs of stations: X_first = R X_second + t, and the keypoints of the pair that agree."""


def starts_of(
    views: Sequence[SceneView],
    pairs: Mapping[tuple[int, int], tuple[Ints, Ints]],
    sizes: tuple[tuple[int, int], tuple[int, int]],
    centre_px: Floats,
    projector_centre_px: tuple[float, float] | None = None,
) -> list[SceneStart]:
    """Trials with their scores, best first; none if no fundamental matrix fits. `centre_px`: the camera's, (2,).
    `projector_centre_px`: if anything is known of it.
    """
    fundamental = fundamental_of(views)
    if fundamental is None:
        return []
    used = sorted(pairs, key=lambda pair: -len(pairs[pair][0]))[:_PAIRS]
    some = {}
    for pair in used:
        chosen = at_random(len(pairs[pair][0]), _JUDGING)
        some[pair] = pairs[pair][0][chosen], pairs[pair][1][chosen]
    (width, _), (wide, high) = sizes
    centres = [((wide - 1) / 2, (high - 1) * height) for height in _LENS_SHIFTS]
    if projector_centre_px is not None:
        centres = [projector_centre_px]
    trials = []
    sample = some_matches([view.matches for view in views], 100).matches
    for camera_focal in _FOCALS * width:
        for projector_focal in _FOCALS * wide:
            for centre in centres:
                camera = without_lens(camera_focal, centre_px)
                projector = without_lens(projector_focal, np.array(centre))
                pose = relative_pose(fundamental, camera, projector, sample.camera_px, sample.projector_px)
                if pose is not None:
                    trials.append(_judged(State(camera, projector, pose), views, some, [*some]))
    return sorted(trials, key=lambda trial: -trial.score)


def with_motions(
    start: SceneStart, views: Sequence[SceneView], pairs: Mapping[tuple[int, int], tuple[Ints, Ints]]
) -> SceneStart:
    """The trial with the motions between all pairs of views."""
    return _judged(start.rig, views, pairs, [*pairs])


def fundamental_of(views: Sequence[MatchedView]) -> Floats | None:
    """The fundamental matrix (3, 3) of camera and projector by all stations' matches; None if none fits."""
    matches = some_matches([view.matches for view in views], _MATCHES).matches
    if len(matches) < 50:
        return None
    cv2.setRNGSeed(0)
    fundamental, _ = cv2.findFundamentalMat(
        matches.camera_px, matches.projector_px, cv2.USAC_MAGSAC, _ON_LINE_PX, 0.9999, 5000
    )
    return None if fundamental is None or fundamental.shape != (3, 3) else np.asarray(fundamental, np.float64)


def relative_pose(
    fundamental: Floats, camera: Floats, projector: Floats, camera_px: Floats, projector_px: Floats
) -> Pose | None:
    """The pose with most points in front of both devices, |t| = 1; None if the devices' pictures allow none."""
    first, second = intrinsic_matrices(np.array([camera[0], projector[0]]), np.stack([camera[1:3], projector[1:3]]))
    essential = second.T @ fundamental @ first
    u, _, vt = np.linalg.svd(essential)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    best, most = None, 0.8
    for turn in (quarter, quarter.T):
        for sign in (1.0, -1.0):
            pose = Pose(u @ turn @ vt, sign * u[:, 2])
            depths = _depths(camera, projector, pose, camera_px, projector_px)
            share = float(np.mean((depths > 0).all(axis=1)))
            if share > most:
                best, most = pose, share
    return best


def _depths(camera: Floats, projector: Floats, pose: Pose, camera_px: Floats, projector_px: Floats) -> Floats:
    """Depths (N, 2) in both devices where their rays are nearest."""
    rays = homogeneous((camera_px - camera[1:3]) / camera[0])
    lines = homogeneous((projector_px - projector[1:3]) / projector[0])
    return depths_of_rays(pose.rotate(rays), lines, pose.translation)


def triangulated(rig: State, view: SceneView) -> Floats:
    """Points (K, 3) of a view's keypoints in the camera's frame, without distortion; NaN behind a device."""
    depths = _depths(rig.camera, rig.projector, rig.pose, view.camera_px, view.projector_px)
    rays = homogeneous((view.camera_px - rig.camera[1:3]) / rig.camera[0])
    behind = depths.min(axis=1) <= 0
    points: Floats = depths[:, :1] * rays
    points[behind] = np.nan
    return points


def _judged(
    rig: State,
    views: Sequence[SceneView],
    pairs: Mapping[tuple[int, int], tuple[Ints, Ints]],
    used: Sequence[tuple[int, int]],
) -> SceneStart:
    points = [triangulated(rig, view) for view in views]
    motions, score = {}, 0.0
    for i, j in used:
        own, matching = pairs[i, j]
        pose, near, worth = _agreement(points[i][own], points[j][matching])
        if np.count_nonzero(near) >= _FEWEST:
            motions[i, j] = pose, near
            score += worth
    return SceneStart(rig, score, motions)


def _agreement(here: Floats, there: Floats) -> tuple[Pose, Bools, float]:
    """The motion that brings most points `there` (M, 3) to those `here`, which agree (M,), and how well they do.

    Pairs whose distances are compatible with those of the same other pairs vote for one motion (Chen et al.,
    "SC²-PCR: a second order spatial compatibility for efficient and robust point cloud registration", 2022).
    """
    best: tuple[Pose, Bools, float] = IDENTITY, np.zeros(len(here), np.bool_), 0.0
    known = np.isfinite(here[:, 2]) & np.isfinite(there[:, 2])
    if np.count_nonzero(known) < _FEWEST:
        return best
    a, b = here[known], there[known]
    apart, beyond = (np.linalg.norm(points[:, None] - points, axis=2) for points in (a, b))
    longer = np.maximum(apart, beyond)
    first = ((np.abs(apart - beyond) < _COMPATIBLE * longer) & (longer > 0)).astype(np.float32)
    second = first * (first @ first)
    distance = float(np.median(a[:, 2]))
    for seed in np.argsort(-second.sum(axis=1))[:_SEEDS]:
        voters = np.append(np.argsort(-second[seed])[: 2 * _FEWEST], seed)
        pose = fit_rigid_motion(a[voters][None], b[voters][None])[0]
        for share in _WITHIN:
            near = np.linalg.norm(pose @ b - a, axis=1) < share * distance
            if np.count_nonzero(near) < _FEWEST:
                break
            pose = fit_rigid_motion(a[near][None], b[near][None])[0]
        off = np.linalg.norm(pose @ b - a, axis=1) / distance
        worth = float(np.sum(np.maximum(0.0, 1 - (off / _WITHIN[-1]) ** 2)))
        if worth > best[2]:
            agreeing = np.zeros(len(here), np.bool_)
            agreeing[known] = off < _WITHIN[0]
            best = pose, agreeing, worth
    return best
