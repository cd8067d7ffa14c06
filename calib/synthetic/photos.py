"""Synthetic matches of photos of a corner by one camera, for tests and benchmarks.

As in captures.py, no code is shared with the solver. Each photo has independent noise, including the first.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.geometry import Calibration, Corner, Intrinsics, Matches, Pose
from calib.synthetic.captures import cast_rays, inside, look_at, random_legs

_UP = np.array([0.0, 0.0, 1.0])


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
    first, *others = (
        Pose(look_at(eye, rng.normal(0, options.aim, 3), _UP, rng.normal(0, options.roll)).T, eye) for eye in eyes
    )
    corner = Corner(first.inverse().translation, first.inverse().rotate(legs))
    pairs = []
    for second in others:
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
