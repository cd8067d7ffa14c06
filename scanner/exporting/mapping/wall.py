"""The largest wall of a room, on which projectors show their picture."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats
from calib.pointcloud import fit_plane
from scanner.errors import InputError
from scanner.exporting.triangles import Mesh

_TRIES, _SAMPLE = 300, 20_000
_NEAR = 0.005  # distance from a plane, over the surface's extent
_ALIKE = np.cos(np.radians(20.0))  # cosine between the normals of a plane's points
_UPRIGHT = np.cos(np.radians(45.0))  # a wall's normal is farther from the vertical than this
_LEVEL = np.cos(np.radians(5.0))
_UP = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, eq=False)
class MappedWall:
    """The points X with `normal` · X = `offset`; the normal (3,) points to the viewer. `within`: distance tolerance of
    its points.
    """

    normal: Floats
    offset: float
    within: float

    @cached_property
    def axes(self) -> Floats:
        """The directions right and up on the wall, (3, 2), unit vectors."""
        vertical = _UP if abs(self.normal @ _UP) < _LEVEL else np.array([0.0, 0.0, 1.0])
        up = vertical - (vertical @ self.normal) * self.normal
        up /= np.linalg.norm(up)
        return np.stack([np.cross(up, self.normal), up], axis=1)


@dataclass(frozen=True, eq=False)
class WallView:
    """The `wall` that shows the picture, and the `eye` (3,) that sees it undistorted; without one, from straight ahead
    and far away.
    """

    wall: MappedWall
    eye: Floats | None

    def refuse_behind(self) -> None:
        """Raise InputError if the eye is behind the wall."""
        if self.eye is not None and self.eye @ self.wall.normal <= self.wall.offset:
            raise InputError(
                "--eye: is behind the largest wall; expected a place in the room, in the axes of mapping.glb: x right, "
                "y up, z backward, in metres"
            )


def largest_wall(mesh: Mesh) -> MappedWall:
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
    return MappedWall(sign * plane.normal, float(sign * plane.offset), within)
