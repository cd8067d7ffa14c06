"""The two kinds of solids in a room, and their intersections with rays.

Rays are origin + t · direction. Directions need not be unit vectors: t is in units of the direction's length. `origins`
and `directions` are (3, n); `origins` may be (3, 1) for rays from one point.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Ints, compiled


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
        return self.inverse @ (points - self.origin[:, None])

    def contains(self, points: Floats) -> Bools:
        """Whether points (3, n) are inside, (n,)."""
        coordinates = self.coordinates(points)
        inside: Bools = np.all((coordinates > 0) & (coordinates < 1), axis=0)
        return inside

    def enter(self, origins: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """Where rays from outside enter: t (n,), infinite for a miss, and the face (n,), 0 for a miss."""
        t, face, far, _ = self._passage(origins, directions)
        missed = ~((t < far) & (t > 0))
        t[missed], face[missed] = np.inf, 0
        return t, face

    def leave(self, origins: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """Where rays from inside leave: t (n,) and the face (n,)."""
        _, _, t, face = self._passage(origins, directions)
        return t, face

    def obstructs(self, origins: Floats, directions: Floats, start: float, end: float) -> Bools:
        """Whether each ray passes through the block between t = start and t = end, (n,)."""
        near, _, far, _ = self._passage(origins, directions)
        return np.maximum(near, start) < np.minimum(far, end)

    def _passage(self, origins: Floats, directions: Floats) -> tuple[Floats, Ints, Floats, Ints]:
        """Where each ray enters and leaves, if it does: t (n,) and the face (n,), each."""
        count = directions.shape[1]
        near, far = np.empty(count), np.empty(count)
        entered, exited = np.empty(count, np.int32), np.empty(count, np.int32)
        rays = np.ascontiguousarray(origins), np.ascontiguousarray(directions)
        _cross_slabs(self.inverse, self.origin, *rays, near, entered, far, exited)
        return near, entered, far, exited


@compiled
def _cross_slabs(
    inverse: Floats,
    origin: Floats,
    origins: Floats,
    directions: Floats,
    near: Floats,
    entered: Ints,
    far: Floats,
    exited: Ints,
) -> None:
    """`_passage` by the slab method of Kay and Kajiya (1986)."""
    from_one = origins.shape[1] == 1
    for ray in range(directions.shape[1]):
        start = 0 if from_one else ray
        first, last = -np.inf, np.inf
        into, out = 0, 0
        for axis in range(3):
            place = 0.0
            step = 0.0
            for k in range(3):
                place += inverse[axis, k] * (origins[k, start] - origin[k])
                step += inverse[axis, k] * directions[k, ray]
            low = -place / step
            high = (1.0 - place) / step
            if low > high:
                low, high = high, low
            if low > first:
                first = low
                into = axis if step > 0 else axis + 3
            if high < last:
                last = high
                out = axis + 3 if step > 0 else axis
            if np.isnan(low):  # along a face
                first = np.inf
        near[ray], entered[ray] = first, into
        far[ray], exited[ray] = last, out


@dataclass(frozen=True)
class Ball:
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
        return (discriminant > 0) & (t > start) & (t < end)

    def _first_root(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        offset = origins - self.centre[:, None]
        a = np.einsum("in,in->n", directions, directions)
        b = np.sum(offset * directions, axis=0)
        c = np.sum(offset * offset, axis=0) - self.radius**2
        discriminant = b * b - a * c
        t: Floats = (-b - np.sqrt(np.maximum(discriminant, 0.0))) / a
        return t, discriminant
