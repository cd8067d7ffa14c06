"""The two kinds of solids in a room, and their intersections with rays.

Rays are origin + t · direction. Directions need not be unit vectors: t is in units of the direction's length. `origins`
and `directions` are (3, n); `origins` may be (3, 1) for rays from one point.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Ints


@dataclass(frozen=True)
class Block:
    """A parallelepiped: the points origin + a · edges[0] + b · edges[1] + c · edges[2] with a, b, c in [0, 1].

    `origin` (3,), `edges` (3, 3) rows, right-handed. Face k is where the k-th of (a, b, c) is 0, face k + 3 where it
    is 1.
    """

    origin: Floats
    edges: Floats

    @cached_property
    def inverse(self) -> Floats:
        """Matrix (3, 3) from a vector in the world to (a, b, c)."""
        return np.asarray(np.linalg.inv(self.edges.T), np.float64)

    @cached_property
    def lengths(self) -> Floats:
        """Lengths of the edges, (3,)."""
        lengths: Floats = np.linalg.norm(self.edges, axis=1)
        return lengths

    @cached_property
    def outward_normals(self) -> Floats:
        """Outward unit normals of the six faces, (6, 3) rows."""
        rising: Floats = self.inverse / np.linalg.norm(self.inverse, axis=1, keepdims=True)
        return np.concatenate([-rising, rising])

    def coordinates(self, points: Floats) -> Floats:
        """Points (3, n) → (a, b, c), (3, n)."""
        coordinates: Floats = self.inverse @ (points - self.origin[:, None])
        return coordinates

    def contains(self, points: Floats) -> Bools:
        """Whether points (3, n) are inside, (n,)."""
        coordinates = self.coordinates(points)
        inside: Bools = np.all((coordinates > 0) & (coordinates < 1), axis=0)
        return inside

    def enter(self, origins: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """Where rays from outside enter: t (n,), infinite for a miss, and the face (n,), 0 for a miss."""
        steps, near, far = self._slabs(origins, directions)
        t = near.max(axis=0)
        missed = ~((t < far.min(axis=0)) & (t > 0))
        face = np.zeros(t.shape, np.int32)
        struck = np.flatnonzero(~missed)
        axis = near[:, struck].argmax(axis=0)
        face[struck] = axis + 3 * (steps[axis, struck] < 0)
        t[missed] = np.inf
        return t, face

    def leave(self, origins: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """Where rays from inside leave: t (n,) and the face (n,)."""
        steps, _, far = self._slabs(origins, directions)
        axis = far.argmin(axis=0)
        rays = np.arange(axis.size)
        face = axis + 3 * (steps[axis, rays] > 0)
        return far[axis, rays], face.astype(np.int32)

    def obstructs(self, origins: Floats, directions: Floats, start: float, end: float) -> Bools:
        """Whether each ray passes through the block between t = start and t = end, (n,)."""
        _, near, far = self._slabs(origins, directions)
        blocked: Bools = np.maximum(near.max(axis=0), start) < np.minimum(far.min(axis=0), end)
        return blocked

    def _slabs(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats, Floats]:
        """Directions (3, n) in (a, b, c), and where each ray enters and leaves each pair of faces, (3, n) and (3, n).

        The slab method of Kay and Kajiya (1986).
        """
        local = self.coordinates(origins)
        steps = self.inverse @ directions
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse_steps = 1.0 / steps
            low = -local * inverse_steps
            high = (1.0 - local) * inverse_steps
        return steps, np.minimum(low, high), np.maximum(low, high)


@dataclass(frozen=True)
class Sphere:
    """The points within `radius` of `centre` (3,)."""

    centre: Floats
    radius: float

    def contains(self, points: Floats) -> Bools:
        """Whether points (3, n) are inside, (n,)."""
        inside: Bools = np.sum((points - self.centre[:, None]) ** 2, axis=0) < self.radius**2
        return inside

    def enter(self, origins: Floats, directions: Floats) -> Floats:
        """Where rays from outside enter: t (n,), infinite for a miss."""
        t, discriminant = self._first_root(origins, directions)
        t[~((discriminant > 0) & (t > 0))] = np.inf
        return t

    def obstructs(self, origins: Floats, directions: Floats, start: float, end: float) -> Bools:
        """Whether each ray enters the sphere between t = start and t = end, (n,)."""
        t, discriminant = self._first_root(origins, directions)
        blocked: Bools = (discriminant > 0) & (t > start) & (t < end)
        return blocked

    def _first_root(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        offset = origins - self.centre[:, None]
        a = np.einsum("in,in->n", directions, directions)
        b = np.sum(offset * directions, axis=0)
        c = np.sum(offset * offset, axis=0) - self.radius**2
        discriminant = b * b - a * c
        t: Floats = (-b - np.sqrt(np.maximum(discriminant, 0.0))) / a
        return t, discriminant
