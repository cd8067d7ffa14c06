"""Synthetic views of a board: corners and matches projected from points in space.

No code is shared with the solver. Points of a bent board are projected into both devices, and noise is added to the
camera's corners and to the projector's pixels.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Intrinsics, Matches, Pose
from calib.numerics import Floats
from calib.synthetic.captures import inside, look_at

_ATTEMPTS = 2000
_CAMERA = Intrinsics(1224, 1024, (1500.0, 1500.0), (628.0, 527.0), (-0.08, 0.05, 0.0, 0.0, 0.0))
_PROJECTOR = Intrinsics(1280, 800, (1900.0, 1900.0), (655.0, 760.0), (-0.03, 0.0, 0.0, 0.0, 0.0))


@dataclass(frozen=True)
class BoardOptions:
    """Parameters: lengths in metres, angles in degrees, noise as a standard deviation of each coordinate.

    `tilt_deg`: range of the angle between the board's normal and the line to the camera; `distance`: its range;
    `aside`: largest offset of its middle, as a share of the picture; `bend`: standard deviation of each term of the
    bend, the height of the board's edge over half its length.
    """

    camera: Intrinsics = _CAMERA
    projector: Intrinsics = _PROJECTOR
    columns: int = 9
    rows: int = 7
    square: float = 0.03
    views: int = 6
    tilt_deg: tuple[float, float] = (10.0, 40.0)
    distance: tuple[float, float] = (0.8, 1.2)
    aside: float = 0.12
    roll_deg: float = 180.0
    matches: int = 8000
    match_px: float = 0.1
    corner_px: float = 0.08
    bend: float = 0.002


@dataclass(frozen=True)
class SyntheticView:
    """A board's corners `points` (N, 2) relative to its middle, their pixels (N, 2), and the matches on it."""

    points: Floats
    corners_px: Floats
    matches: Matches


@dataclass(frozen=True)
class SyntheticBoards:
    """Views with their ground truth.

    Heights are `reach` times a², ab, b² times `bend` (3,), with a, b in units of `reach`. `poses`: of the boards in
    the camera's frame; a board's origin is its middle.
    """

    views: tuple[SyntheticView, ...]
    calibration: Calibration
    options: BoardOptions
    bend: Floats
    reach: float
    poses: tuple[Pose, ...]


def random_boards(rng: np.random.Generator, options: BoardOptions | None = None, **changes: Any) -> SyntheticBoards:
    """A random rig, and views of a board that both devices see completely. Raises ValueError if none is found."""
    options = replace(options or BoardOptions(), **changes)
    distance = float(np.mean(options.distance))
    target = np.array([0.0, 0.0, distance])
    eye = np.array([rng.uniform(0.2, 0.3) * rng.choice([-1, 1]), rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05)])
    # The middle of the projector's picture is on the target; its principal point is not, as with most projectors.
    _, throw = options.projector.unproject(np.array([[options.projector.width / 2, options.projector.height / 2]]))[
        0, :2
    ]
    rotation = Rotation.from_rotvec([-np.arctan(throw), 0, 0]).as_matrix() @ look_at(
        eye, target, np.array([0.0, -1.0, 0.0]), np.radians(rng.normal(0, 2))
    )
    calibration = Calibration(options.camera, options.projector, Pose(rotation, -rotation @ eye), unit="m")
    reach = options.square * (max(options.columns, options.rows) + 1) / 2
    bend = rng.normal(0, options.bend, 3)
    views, poses = [], []
    for _ in range(_ATTEMPTS):
        pose = _random_pose(rng, options, calibration)
        view = _seen(rng, options, calibration, bend, reach, pose)
        if view is not None:
            views.append(view)
            poses.append(pose)
        if len(views) == options.views:
            return SyntheticBoards(tuple(views), calibration, options, bend, reach, tuple(poses))
    raise ValueError("no pose of the board that both devices see whole")


def _random_pose(rng: np.random.Generator, options: BoardOptions, calibration: Calibration) -> Pose:
    """Of a board in the camera's frame."""
    width, height = calibration.camera.size
    pixel = np.array([width, height]) * (0.5 + rng.uniform(-options.aside, options.aside, 2))
    ray = calibration.camera.unproject(pixel[None])[0]
    middle = rng.uniform(*options.distance) * ray
    direction = rng.uniform(0, 2 * np.pi)
    tilt = np.radians(rng.uniform(*options.tilt_deg)) * np.array([np.cos(direction), np.sin(direction), 0.0])
    roll = np.radians(rng.uniform(-options.roll_deg, options.roll_deg))
    rotation = Rotation.from_rotvec(tilt).as_matrix() @ Rotation.from_rotvec([0, 0, roll]).as_matrix()
    return Pose(rotation, middle)


def _seen(
    rng: np.random.Generator,
    options: BoardOptions,
    rig: Calibration,
    bend: Floats,
    reach: float,
    pose: Pose,
) -> SyntheticView | None:
    """The view of a posed board; None if a part of it is outside of either picture."""
    counts = np.array([options.columns, options.rows])
    columns, rows = np.meshgrid(np.arange(options.columns), np.arange(options.rows))
    corners = (np.stack([columns.ravel(), rows.ravel()], axis=1) - (counts - 1) / 2) * options.square
    spread = rng.uniform(-0.5, 0.5, (options.matches, 2)) * (counts + 0.8) * options.square
    both = np.concatenate([corners, spread])
    a, b = both.T / reach
    heights = reach * np.stack([a * a, a * b, b * b], axis=1) @ bend
    points = pose @ np.concatenate([both, heights[:, None]], axis=1)
    camera_px = rig.camera.project(points)
    projector_px = rig.projector.project(rig.pose @ points)
    if not (inside(camera_px, rig.camera).all() and inside(projector_px, rig.projector).all()):
        return None
    corners_px = camera_px[: len(corners)] + rng.normal(0, options.corner_px, corners.shape)
    noisy = projector_px[len(corners) :] + rng.normal(0, options.match_px, spread.shape)
    return SyntheticView(corners, corners_px, Matches(camera_px[len(corners) :], noisy))
