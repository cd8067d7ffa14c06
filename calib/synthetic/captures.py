"""Synthetic matches of a corner, by a rig or in photos by one camera, from 3-D points, for tests and benchmarks.

No code is shared with the solver. Points on three walls are projected into both devices, and noise is added to the
projector's pixels; each photo has independent noise, including the first.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Corner, Intrinsics, Matches, Pose
from calib.numerics import Bools, Floats, Ints

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class SyntheticCapture:
    """Matches with their ground truth."""

    matches: Matches
    calibration: Calibration
    corner: Corner


# The rig of the paper (its section 5.1), at its full camera resolution.
PAPER_CAMERA = Intrinsics(2448, 2048, (1791.1, 1791.1), (1256.3, 1054.3))
PAPER_PROJECTOR = Intrinsics(854, 480, (1247.3, 1247.3), (377.1, 234.0))


def look_at(eye: Floats, target: Floats, up: Floats, roll: float = 0.0) -> Floats:
    """Rotation (3, 3) from the world into a device at `eye` that looks at `target`; `roll` in radians."""
    z = target - eye
    z = z / np.linalg.norm(z)
    x = np.cross(z, up)
    x = x / np.linalg.norm(x)
    frame = np.stack([x, np.cross(z, x), z])
    return Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix() @ frame


@dataclass(frozen=True)
class CaptureOptions:
    """Parameters: lengths in metres; `roll`: standard deviation of each device's roll in radians.

    `noise_px` is the standard deviation of each coordinate of the projector pixel; `outliers` the share of matches that
    are replaced by random ones (face −1); each wall's direction is turned by a normal angle of `walls_off_deg`.
    `slants`: ranges of the direction from the vertex to the camera along the three legs. `forward`: angle in radians
    between the baseline and the line to the vertex, across it if None. `least_share`: of the matches on each wall.
    `parallel_m`: the third wall is instead parallel to the first, that far in front of it.
    """

    camera: Intrinsics = PAPER_CAMERA
    projector: Intrinsics = PAPER_PROJECTOR
    count: int = 50_000
    noise_px: float = 0.1
    distance: tuple[float, float] = (1.5, 4.0)
    baseline: tuple[float, float] = (0.3, 0.8)
    roll: float = 0.1
    walls_off_deg: float = 0.0
    outliers: float = 0.0
    slants: tuple[tuple[float, float], ...] = ((0.25, 1.0),) * 3
    forward: float | None = None
    least_share: float = 0.1
    parallel_m: float | None = None


def random_capture(
    rng: np.random.Generator, options: CaptureOptions | None = None, *, attempts: int = 1000, **changes: Any
) -> SyntheticCapture:
    """A corner from a random place in its room, sampled on a jittered grid over the projector's image.

    Repeats until each wall holds its least share of the matches. Raises ValueError after `attempts`. `changes`: options
    by name.
    """
    (capture,) = random_captures(rng, 1, options, attempts=attempts, **changes)
    return capture


def random_captures(
    rng: np.random.Generator,
    number: int,
    options: CaptureOptions | None = None,
    *,
    same: bool = True,
    rig: Calibration | None = None,
    attempts: int = 1000,
    **changes: Any,
) -> list[SyntheticCapture]:
    """Captures of one corner by one rig from random places, or of different corners, each with random face order.

    `rig`: relative pose of the devices; random if left out. Raises ValueError after `attempts`.
    """
    options = replace(options or CaptureOptions(), **changes)
    legs = random_legs(rng, options.walls_off_deg)
    captures: list[SyntheticCapture] = []
    while len(captures) < number:
        attempts -= 1
        if attempts < 0:
            raise ValueError("no view of the corner that both devices see")
        capture = _one_capture(rng, options, legs, rig)
        if capture is None:
            continue
        rig = capture.calibration
        captures.append(capture if number == 1 else _in_another_order(capture, rng.permutation(3)))
        legs = legs if same else random_legs(rng, options.walls_off_deg)
    return captures


def inside(pixels: Floats, device: Intrinsics) -> Bools:
    """Which pixels (N, 2) are in a device's image, (N,)."""
    with np.errstate(invalid="ignore"):
        inside_both: Bools = np.all((pixels >= 0) & (pixels <= (device.width - 1, device.height - 1)), axis=1)
    return inside_both


def random_legs(rng: np.random.Generator, walls_off_deg: float) -> Floats:
    """Unit rows (3, 3) along the axes, each rotated by a normal angle."""
    legs = np.eye(3) + np.radians(walls_off_deg) * np.array(
        [[0, rng.normal(), 0], [0, 0, rng.normal()], [rng.normal(), 0, 0]]
    )
    unit: Floats = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    return unit


def _in_another_order(capture: SyntheticCapture, order: Ints) -> SyntheticCapture:
    """The same capture, face s numbered order[s]."""
    face = capture.matches.labels
    legs = np.empty((3, 3))
    legs[order] = capture.corner.legs
    renumbered = np.where(face >= 0, order[face], face).astype(np.int32)
    return replace(capture, matches=capture.matches.with_faces(renumbered), corner=Corner(capture.corner.vertex, legs))


def _one_capture(
    rng: np.random.Generator, options: CaptureOptions, legs_world: Floats, rig: Calibration | None
) -> SyntheticCapture | None:
    camera, projector, count = options.camera, options.projector, options.count
    # World: vertex at the origin, room in the positive octant, z up.
    direction = rng.uniform(*np.transpose(options.slants))
    camera_eye = rng.uniform(*options.distance) * direction / np.linalg.norm(direction)
    up = np.array([0.0, 0.0, 1.0])
    spread = 0.05 * np.linalg.norm(camera_eye)
    to_camera = Pose(
        look_at(camera_eye, rng.normal(0, spread, 3), up, rng.normal(0, options.roll)).T, camera_eye
    ).inverse()
    if rig is None:
        aside = np.cross(direction, rng.normal(size=3))
        aside /= np.linalg.norm(aside)
        if options.forward is not None:
            ahead = direction / np.linalg.norm(direction) * rng.choice([-1.0, 1.0])
            aside = np.cos(options.forward) * ahead + np.sin(options.forward) * aside
        projector_eye = camera_eye + rng.uniform(*options.baseline) * aside
        turn = look_at(projector_eye, rng.normal(0, spread, 3), up, rng.normal(0, options.roll))
        pose = Pose(turn.T, projector_eye).inverse() @ to_camera.inverse()
    else:
        pose = rig.pose
        projector_eye = (pose @ to_camera).inverse().translation
    if np.any(projector_eye < 0.4 * np.transpose(options.slants)[0] * np.linalg.norm(projector_eye)):
        return None

    corner = Corner(to_camera.translation, to_camera.rotate(legs_world))

    pixels = jittered_grid(rng, projector, count)
    normals, heights = corner.normals, corner.normals @ corner.vertex
    if options.parallel_m is not None:
        normals, heights = normals[[0, 1, 0]], heights[[0, 1, 0]] + np.array([0.0, 0.0, options.parallel_m])
    back = pose.inverse()
    points, face = cast_rays(back.rotate(projector.unproject(pixels)), back.translation, normals, heights)
    camera_px = camera.project(points)
    visible = inside(camera_px, camera)
    camera_px, pixels, face = camera_px[visible], pixels[visible], face[visible]
    if np.bincount(face, minlength=3).min() < max(options.least_share * count, 4):
        return None

    projector_px = pixels + rng.normal(0, options.noise_px, pixels.shape) if options.noise_px else pixels
    wrong = rng.random(len(face)) < options.outliers
    projector_px[wrong] = rng.uniform((0, 0), (projector.width, projector.height), (int(wrong.sum()), 2))
    face = np.where(wrong, -1, face).astype(np.int32)
    return SyntheticCapture(
        Matches(camera_px, projector_px, face),
        Calibration(camera, projector, pose, unit="m"),
        corner,
    )


def jittered_grid(rng: np.random.Generator, device: Intrinsics, count: int) -> Floats:
    """About `count` pixels (N, 2) all over a device's image, one at random in each square of a grid."""
    step = np.sqrt(device.width * device.height / count)
    x, y = np.meshgrid(np.arange(0, device.width - 1, step), np.arange(0, device.height - 1, step))
    grid = np.stack([x.ravel(), y.ravel()], axis=1)
    return np.clip(grid + rng.uniform(0, step, grid.shape), 0, (device.width - 1, device.height - 1))


def cast_rays(directions: Floats, origin: Floats, normals: Floats, heights: Floats) -> tuple[Floats, Ints]:
    """First wall n · X = height hit by each ray (N, 3) from `origin`: points (N, 3) and wall labels (N,)."""
    with np.errstate(divide="ignore"):
        lengths = (heights - normals @ origin) / (directions @ normals.T)
    lengths[~(lengths > 0)] = np.inf
    face = np.argmin(lengths, axis=1)
    points = origin + lengths[np.arange(len(face)), face, None] * directions
    return points, face.astype(np.int32)


@dataclass(frozen=True)
class SyntheticPhotoOptions:
    """Parameters: lengths in distances of the first photo from the vertex.

    `count`: matches of each further photo with the first; `noise_px` of each coordinate in every photo. `shift`: the
    principal point is off the image's centre by up to that share of the width, as in a crop. `aim`: standard deviation
    of the point that the camera looks at around the vertex. `least_share`: of the matches on each wall.
    """

    width: int = 1600
    height: int = 1200
    focal_px: tuple[float, float] = (1200.0, 2000.0)
    distortion: float = 0.0
    shift: float = 0.15
    count: int = 2000
    noise_px: float = 0.3
    first_noise: bool = True
    baseline: float = 0.3
    photos: int = 2
    roll: float = 0.1
    aim: float = 0.05
    walls_off_deg: float = 0.0
    slants: tuple[float, float] = (0.25, 1.0)
    least_share: float = 0.1


@dataclass(frozen=True)
class SyntheticPhotos:
    """`pairs`: matches of the first photo with each other one, and the true calibration of that pair (|t| = 1).
    `corner`: in the first photo's frame, in baselines of the first pair.
    """

    pairs: tuple[tuple[Matches, Calibration], ...]
    corner: Corner

    @property
    def camera(self) -> Intrinsics:
        """The camera of all photos."""
        return self.pairs[0][1].camera


def random_photos(
    rng: np.random.Generator, options: SyntheticPhotoOptions | None = None, *, attempts: int = 2000, **changes: Any
) -> SyntheticPhotos:
    """Photos of a corner from random places in its room; repeats until every wall holds its least share.

    Raises ValueError after `attempts`. `changes`: options by name.
    """
    options = replace(options or SyntheticPhotoOptions(), **changes)
    for _ in range(attempts):
        photos = _draw(rng, options)
        if photos is not None:
            return photos
    raise ValueError("no view of the corner that all photos share")


def _draw(rng: np.random.Generator, options: SyntheticPhotoOptions) -> SyntheticPhotos | None:
    camera = _camera(rng, options)
    legs = random_legs(rng, options.walls_off_deg)
    eye = rng.uniform(*options.slants, 3)
    eye /= np.linalg.norm(eye)
    eyes = [eye]
    while len(eyes) < options.photos:
        aside = np.cross(eye, rng.normal(size=3))
        eyes.append(eye + options.baseline * aside / np.linalg.norm(aside))
    if min(centre.min() for centre in eyes) < 0.1:
        return None
    first, *further = (
        Pose(look_at(eye, rng.normal(0, options.aim, 3), _UP, rng.normal(0, options.roll)).T, eye) for eye in eyes
    )
    corner = Corner(first.inverse().translation, first.inverse().rotate(legs))
    pairs = []
    for second in further:
        pose = second.inverse() @ first
        matches = _matches(rng, options, camera, corner, pose)
        if matches is None:
            return None
        pairs.append((matches, Calibration(camera, camera, pose.in_baselines)))
    return SyntheticPhotos(tuple(pairs), Corner(corner.vertex / options.baseline, corner.legs))


def _camera(rng: np.random.Generator, options: SyntheticPhotoOptions) -> Intrinsics:
    focal = float(rng.uniform(*options.focal_px))
    x, y = rng.uniform(-options.shift, options.shift, 2) * options.width
    centre = ((options.width - 1) / 2 + float(x), (options.height - 1) / 2 + float(y))
    return Intrinsics(options.width, options.height, (focal, focal), centre, (options.distortion, 0.0, 0.0, 0.0, 0.0))


def _matches(
    rng: np.random.Generator,
    options: SyntheticPhotoOptions,
    camera: Intrinsics,
    corner: Corner,
    pose: Pose,
) -> Matches | None:
    """Matches of random points that both photos see; None if a wall has too few of them."""
    pixels = rng.uniform((0, 0), (camera.width - 1, camera.height - 1), (4 * options.count, 2))
    points, face = cast_rays(camera.unproject(pixels), np.zeros(3), corner.normals, corner.normals @ corner.vertex)
    second = camera.project(pose @ points)
    visible = np.flatnonzero(inside(second, camera))[: options.count]
    face = face[visible]
    if len(visible) < options.count or np.bincount(face, minlength=3).min() < options.least_share * options.count:
        return None
    first, second = pixels[visible], second[visible]
    if options.first_noise:
        first = first + rng.normal(0, options.noise_px, first.shape)
    return Matches(first, second + rng.normal(0, options.noise_px, second.shape), face)
