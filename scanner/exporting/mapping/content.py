"""The picture that all projectors show together: a rectangle on the largest wall, seen straight on or from one eye."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import Size
from calib.numerics import Bools, Floats
from calib.pointcloud import fit_plane
from scanner.errors import InputError
from scanner.exporting.mapping.projector_view import ProjectorView
from scanner.exporting.triangles import Mesh

_TRIES, _SAMPLE = 300, 20_000
_NEAR = 0.005  # distance from a plane, over the surface's extent
_ALIKE = np.cos(np.radians(20.0))  # cosine between the normals of a plane's points
_UPRIGHT = np.cos(np.radians(45.0))  # a wall's normal is farther from the vertical than this
_GRAZING = np.sin(np.radians(10.0))  # surfaces seen at a smaller angle show streaks
_UP = np.array([0.0, -1.0, 0.0])
_LARGEST_PX = 16_384


@dataclass(frozen=True, eq=False)
class Wall:
    """The points X with `normal` · X = `offset`; the normal (3,) points to the viewer. `within`: distance tolerance of
    its points.
    """

    normal: Floats
    offset: float
    within: float


@dataclass(frozen=True, eq=False)
class Content:
    """A rectangle on a wall: its lower left corner `origin`, unit vectors `right` and `up` (3,), width and height
    `extent`.

    `size`: of the picture, in square pixels. `eye` (3,): viewpoint without distortion; None: parallel projection along
    the wall's normal.
    """

    wall: Wall
    origin: Floats
    right: Floats
    up: Floats
    extent: tuple[float, float]
    size: Size
    eye: Floats | None = None

    def coordinates(self, view: ProjectorView) -> Floats:
        """Of each pixel of a projector (H, W, 2), as shares of width and height from the lower left corner; NaN where
        the content does not reach.
        """
        normal, points = self.wall.normal, view.points
        if self.eye is None:
            towards, on_wall = np.broadcast_to(normal, points.shape), points
        else:
            towards = self.eye - points
            ahead = towards @ normal
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.where(ahead > 0, (self.eye @ normal - self.wall.offset) / ahead, np.nan)
            on_wall = self.eye - share[..., None] * towards
            towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        at = np.stack([(on_wall - self.origin) @ axis for axis in (self.right, self.up)], axis=-1) / self.extent
        reached = (np.sum(view.normals * towards, axis=-1) > _GRAZING) & np.all((at >= 0) & (at <= 1), axis=-1)
        return np.where(reached[..., None], at, np.nan)


def largest_wall(mesh: Mesh) -> Wall:
    """The plane with the most surface among those that are upright, or of all if none is. The first device is upright.

    RANSAC over points with normals, weighted by the area around them, then least squares.
    """
    corners = mesh.points[mesh.triangles]
    double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    area = np.bincount(mesh.triangles.ravel(), np.repeat(double, 3), len(mesh.points))
    rng = np.random.default_rng(0)
    sample = rng.choice(len(area), _SAMPLE, p=area / area.sum())
    points, normals = mesh.points[sample], mesh.normals[sample]
    upright = np.flatnonzero(np.abs(normals @ _UP) < _UPRIGHT)
    tried = rng.choice(upright if len(upright) else _SAMPLE, _TRIES)
    within = _NEAR * float(np.linalg.norm(np.ptp(mesh.points, axis=0)))

    def on_plane(number: int) -> Bools:
        near = np.abs((points - points[number]) @ normals[number]) < within
        alike: Bools = near & (normals @ normals[number] > _ALIKE)
        return alike

    best = max(tried, key=lambda number: np.count_nonzero(on_plane(number)))
    on = points[on_plane(best)]
    try:
        plane = fit_plane(on, np.arange(len(on)))
    except ValueError as error:
        raise InputError(f"no wall is found to show a picture on: {error}") from error
    sign = np.sign(plane.normal @ normals[best])
    return Wall(sign * plane.normal, float(sign * plane.offset), within)


def content_on(wall: Wall, projectors: Sequence[ProjectorView], eye: Floats | None) -> Content:
    """The smallest rectangle that holds all that is lit of the wall, with pixels as fine as the finest projector's.

    Raises InputError if the eye is behind the wall, or no projector lights it.
    """
    if eye is not None and eye @ wall.normal <= wall.offset:
        raise InputError(
            "--eye: is behind the largest wall; expected a place in the room, in the axes of mapping.glb: x right, "
            "y up, z backward, in metres"
        )
    vertical = _UP if abs(wall.normal @ _UP) < np.cos(np.radians(5.0)) else np.array([0.0, 0.0, 1.0])
    up = vertical - (vertical @ wall.normal) * wall.normal
    up /= np.linalg.norm(up)
    axes = np.stack([np.cross(up, wall.normal), up], axis=1)
    lit, finest = [], np.inf
    for view in projectors:
        on_wall = np.abs(view.points @ wall.normal - wall.offset) < wall.within
        if not on_wall.any():
            continue
        at = view.points @ axes
        across, down = np.gradient(at, axis=1), np.gradient(at, axis=0)
        pixel = np.sqrt(np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]))[on_wall]
        lit.append(at[on_wall])
        finest = min(finest, float(np.nanmedian(pixel)))
    if not lit or not np.isfinite(finest) or finest <= 0:
        raise InputError("no projector lights the largest wall, so there is nothing to show a picture on")
    low, high = np.min([at.min(axis=0) for at in lit], axis=0), np.max([at.max(axis=0) for at in lit], axis=0)
    step = max(finest, float(np.max(high - low)) / _LARGEST_PX)
    width, height = (max(1, int(np.ceil(side / step))) for side in high - low)
    origin = axes @ low + wall.offset * wall.normal
    return Content(wall, origin, axes[:, 0], up, (width * step, height * step), Size(width, height), eye)
