"""The surfaces of a scene: the room from inside, solids from outside."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Ints
from hw.simulated.shapes import Ball, Block

# Distance of the start of a ray from its surface, over the ray's length: above rounding errors, below visible detail.
_CLEARANCE = 1e-6


class Label(IntEnum):
    """What a surface belongs to; the first three are the faces of the corner."""

    WALL_X = 0
    WALL_Y = 1
    FLOOR = 2
    SURROUNDINGS = 3
    FURNITURE = 4
    SPHERE = 5


@dataclass(frozen=True)
class Scene:
    """A closed room, the blocks in it, and up to two spheres, the ends of a ball bar.

    Surfaces are numbered: the room's faces 0 … 5 (0, 1, 2 meet in the corner; 3, 4 are the opposite walls, 5 the
    ceiling), then six faces of each block, then the spheres.

    Each surface has coordinates (u, v) in metres: on face k of a block along the edges k + 1 and k + 2 (cyclic), on a
    sphere along the equator and the meridians. `all_round`: the rig goes round the whole room instead of facing one
    corner.
    """

    room: Block
    blocks: tuple[Block, ...] = ()
    sphere: Ball | None = None
    second_sphere: Ball | None = None
    all_round: bool = False

    @property
    def spheres(self) -> dict[int, Ball]:
        """The spheres by their surface numbers."""
        there = (sphere for sphere in (self.sphere, self.second_sphere) if sphere is not None)
        return dict(enumerate(there, start=self.sphere_surface))

    @property
    def sphere_surface(self) -> int:
        """The surface number of the first sphere, if there is one."""
        return 6 + 6 * len(self.blocks)

    @property
    def _solids(self) -> tuple[Block | Ball, ...]:
        """The blocks and spheres in the room."""
        return (*self.blocks, *self.spheres.values())

    @property
    def surface_count(self) -> int:
        """The number of surfaces."""
        return 6 + 6 * len(self.blocks) + len(self.spheres)

    @cached_property
    def labels(self) -> Ints:
        """The `Label` of each surface."""
        labels = [Label.WALL_X, Label.WALL_Y, Label.FLOOR] + 3 * [Label.SURROUNDINGS]
        labels += 6 * len(self.blocks) * [Label.FURNITURE] + len(self.spheres) * [Label.SPHERE]
        return np.array(labels, np.int32)

    @cached_property
    def sizes(self) -> Floats:
        """Extent of each surface along u and v in metres, (surfaces, 2)."""
        sizes = [block.lengths[_in_face(face)] for block in (self.room, *self.blocks) for face in range(6)]
        sizes += [sphere.radius * np.array([2 * np.pi, np.pi]) for sphere in self.spheres.values()]
        return np.array(sizes)

    def cast(self, origins: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """First surface hit by each ray (3, n) from inside the room: t (n,) and the surface number (n,)."""
        t, surface = self.room.leave(origins, directions)
        for i, block in enumerate(self.blocks):
            t_block, face = block.enter(origins, directions)
            nearer = np.flatnonzero(t_block < t)
            t[nearer] = t_block[nearer]
            surface[nearer] = face[nearer] + 6 * (i + 1)
        for number, sphere in self.spheres.items():
            t_sphere = sphere.enter(origins, directions)
            nearer = np.flatnonzero(t_sphere < t)
            t[nearer] = t_sphere[nearer]
            surface[nearer] = number
        return t, surface

    def occluded(self, points: Floats, eye: Floats) -> Bools:
        """Whether a solid occludes points (3, n) from an eye (3,), (n,). The room is convex and occludes nothing."""
        directions = eye[:, None] - points
        hidden = np.zeros(points.shape[1], np.bool_)
        for solid in self._solids:
            hidden |= solid.obstructs(points, directions, _CLEARANCE, 1.0)
        return hidden

    def is_free(self, points: Floats) -> Bools:
        """Whether points (3, n) are inside the room and outside all solids, (n,)."""
        free = self.room.contains(points)
        for solid in self._solids:
            free &= ~solid.contains(points)
        return free

    def normals(self, surface: Ints, points: Floats) -> Floats:
        """Unit normals (3, n) into the free space, at points (3, n) on surfaces (n,)."""
        normals = self._face_normals[:, surface]
        for number, sphere in self.spheres.items():
            on = np.flatnonzero(surface == number)
            normals[:, on] = (points[:, on] - sphere.centre[:, None]) / sphere.radius
        return normals

    def surface_coordinates(self, surface: Ints, points: Floats) -> Floats:
        """(u, v) in metres, (2, n), of points (3, n) on surfaces (n,)."""
        frames, offsets = self._frames
        uv = offsets[:, surface]
        for axis in range(3):
            uv += frames[:, axis, surface] * points[axis]
        for number, sphere in self.spheres.items():
            on = np.flatnonzero(surface == number)
            x, y, z = points[:, on] - sphere.centre[:, None]
            latitude = np.arcsin((z / sphere.radius).clip(-1.0, 1.0))
            uv[:, on] = sphere.radius * np.stack([np.arctan2(y, x) + np.pi, latitude + np.pi / 2])
        return uv

    def points_on(self, surface: int, uv: Floats) -> Floats:
        """Points (3, n) of one surface at (u, v) (2, n): the inverse of `surface_coordinates`."""
        sphere = self.spheres.get(surface)
        if sphere is not None:
            longitude, latitude = uv[0] / sphere.radius - np.pi, uv[1] / sphere.radius - np.pi / 2
            across = np.cos(latitude)
            unit = np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)])
            return sphere.centre[:, None] + sphere.radius * unit
        block = (self.room, *self.blocks)[surface // 6]
        face = surface % 6
        first, second = _in_face(face)
        start = block.origin + (block.edges[face - 3] if face >= 3 else 0.0)
        u, v = uv
        points: Floats = (
            start[:, None]
            + block.edges[first][:, None] * (u / block.lengths[first])
            + block.edges[second][:, None] * (v / block.lengths[second])
        )
        return points

    @cached_property
    def _face_normals(self) -> Floats:
        """(3, surfaces); zero for spheres."""
        normals = [-self.room.outward_normals] + [block.outward_normals for block in self.blocks]
        normals.append(np.zeros((len(self.spheres), 3)))
        return np.concatenate(normals).T.copy()

    @cached_property
    def _frames(self) -> tuple[Floats, Floats]:
        """uv = frames · point + offsets: (2, 3, surfaces) and (2, surfaces)."""
        frames = np.zeros((2, 3, self.surface_count))
        offsets = np.zeros((2, self.surface_count))
        for i, block in enumerate((self.room, *self.blocks)):
            for face in range(6):
                axes = _in_face(face)
                frame = block.inverse[axes] * block.lengths[axes, None]
                frames[:, :, 6 * i + face] = frame
                offsets[:, 6 * i + face] = -frame @ block.origin
        return frames, offsets


def _in_face(face: int) -> list[int]:
    """The two edges of a block that span a face."""
    return [(face + 1) % 3, (face + 2) % 3]
