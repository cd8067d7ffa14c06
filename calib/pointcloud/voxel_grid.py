"""Downsampling by a voxel grid: one point is kept in each voxel."""

import numpy as np

from calib.numerics import Bools, Floats, Ints, compiled

_INDEX_BITS = 32
_INDEX, _TAG = (1 << _INDEX_BITS) - 1, (1 << 31) - 1
# Teschner et al., "Optimized spatial hashing", 2003; and 2⁶⁴ over the golden ratio, as a signed number (Knuth).
_PRIMES = (73856093, 19349663, 83492791)
_GOLDEN = -7046029254386353131


def nearest_in_voxels(points: Floats, distance: Floats, size: float) -> Ints:
    """The sorted indices (M,) of the points with the least `distance` (N,) in each voxel with edges of `size`.

    Points (N, 3) must be finite, at most 2³². Of equally near ones the first is kept.
    """
    slots = np.zeros(1 << int(np.ceil(np.log2(1.5 * len(points) + 1))), np.int64)
    _enter(points, distance, size, slots)
    kept = np.zeros(len(points), np.bool_)
    _mark(slots, kept)
    return np.flatnonzero(kept)


@compiled
def _enter(points: Floats, distance: Floats, size: float, slots: Ints) -> None:
    """Insert points into a hash table with open addressing. A slot holds a tag and a point's index from 1, or 0."""
    last = len(slots) - 1
    for i in range(len(points)):
        x, y, z = np.floor(points[i, 0] / size), np.floor(points[i, 1] / size), np.floor(points[i, 2] / size)
        mixed = ((int(x) * _PRIMES[0]) ^ (int(y) * _PRIMES[1]) ^ (int(z) * _PRIMES[2])) * _GOLDEN
        slot, tag = (mixed >> _INDEX_BITS) & last, mixed & _TAG
        while slots[slot] != 0:
            member = (slots[slot] & _INDEX) - 1
            if slots[slot] >> _INDEX_BITS == tag and (
                x == np.floor(points[member, 0] / size)
                and y == np.floor(points[member, 1] / size)
                and z == np.floor(points[member, 2] / size)
            ):
                break
            slot = (slot + 1) & last
        if slots[slot] == 0 or distance[i] < distance[(slots[slot] & _INDEX) - 1]:
            slots[slot] = (tag << _INDEX_BITS) | (i + 1)


@compiled
def _mark(slots: Ints, kept: Bools) -> None:
    for entry in slots:
        if entry != 0:
            kept[(entry & _INDEX) - 1] = True
