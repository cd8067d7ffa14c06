"""Two surfaces of any origin, sampled alike, with their middles at the origin; and the free space before them, where
the scanner's place is known: what would have hidden a measured point is not there.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, evenly_spread, median
from calib.registration.sampled_surface import SampledSurface, extent_of, measured_noise, sample_surface, spacing_of
from calib.registration.segments import Facets, grow_planes

_SAMPLE = 2000
_BIN_SPACINGS = 2.0  # angular distances of neighbouring points in an edge of a bin
_MOST_BINS = 4_000_000
_MARGIN = 0.01  # of the range
_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Least ranges of a scan over the sphere of directions from its scanner."""

    eye: Floats
    """(3,): the scanner."""
    near: NDArray[np.float32]
    """(H, W): the least range around each bin of azimuth and inclination; 0 where a bin near it has no point."""
    bins_per_rad: float

    @classmethod
    def of(cls, points: Floats, eye: Floats) -> "FreeSpace":
        """Of points (N, 3) that were seen from one place."""
        ways, ranges = _ways(points, eye)
        tree = scipy.spatial.cKDTree(ways, balanced_tree=False, compact_nodes=False)
        spacing = median(np.asarray(tree.query(evenly_spread(ways, _SAMPLE), 4)[0])[:, -1]) / 1.5
        per_rad = min(1 / max(_BIN_SPACINGS * spacing, 1e-9), float(np.sqrt(_MOST_BINS / (2 * np.pi**2))))
        shape = int(np.ceil(np.pi * per_rad)) + 1, int(np.ceil(2 * np.pi * per_rad)) + 1
        row, column = _bins(ways, per_rad)
        near = np.full(shape, np.inf, np.float32)
        np.minimum.at(near, (row, column), ranges.astype(np.float32))
        kernel = np.ones((3, 3), np.uint8)
        least = cv2.erode(near, kernel)
        known = cv2.erode(np.isfinite(near).astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        return cls(eye, np.where(known > 0, least, np.float32(0)), per_rad)

    def is_violated(self, points: Floats, by: float) -> Bools:
        """Which points (N, 3) are in front of what was seen, by more than a distance, (N,)."""
        ways, ranges = _ways(points, self.eye)
        near = self.near[_bins(ways, self.bins_per_rad)].astype(np.float64)
        violated: Bools = (near > 0) & (ranges * (1 + _MARGIN) + by < near)
        return violated


def _ways(points: Floats, eye: Floats) -> tuple[Floats, Floats]:
    """Unit directions (N, 3) of points from an eye, and ranges (N,)."""
    ways = points - eye
    ranges = np.linalg.norm(ways, axis=1)
    return ways / np.maximum(ranges, 1e-300)[:, None], ranges


def _bins(ways: Floats, per_rad: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    inclination = np.arccos(np.clip(ways[:, 1], -1, 1))
    azimuth = np.arctan2(ways[:, 0], ways[:, 2]) + np.pi
    return (inclination * per_rad).astype(np.int64), (azimuth * per_rad).astype(np.int64)


MANY_SAMPLES, ALL_SAMPLES = 4000, 16_000  # by which hypotheses are judged, and the last ones
ACROSS = 40.0  # coarse cells across the smaller surface
_MOST_POINTS, _EXTENT_SAMPLE = 400_000, 20_000
_FINE = 160.0  # fine cells across the smaller surface
_MOST_COARSE, _COARSENINGS = 40_000, 3  # samples of the larger surface; attempts to have no more
_SPACINGS = 1.5  # least edge of a fine cell, in distances of neighbouring points
_NOISES, _OF_CELL = 4.0, 0.2  # tolerance: standard deviations of samples, and share of a fine cell
# Of planes that bound a surface: most of them, least share of the samples on one, most of the samples behind it; and
# distance, in fine cells, within which samples belong to it.
_SIGMAS = 3.0
_BOUNDS, _LEAST_BOUND, _BEHIND, _ON_BOUND = 12, 0.02, 0.05, 1.5


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """A surface as points in space."""

    points: Floats
    """(N, 3)"""
    normals: Floats | None = None
    """(N, 3), towards the side that was seen; None if unknown."""
    noise: float | None = None
    """Standard deviation of a point along its normal; measured if None."""
    eye: Floats | None = None
    """(3,): the scanner, if all points were seen from one place and it is known: the space in between is free."""
    is_closed: bool = False
    """Whether it is all of a body's surface, as a CAD model is: nothing of the body is elsewhere."""


@dataclass(frozen=True, eq=False)
class SurfaceSide:
    """A surface with its middle at the origin."""

    fine: SampledSurface
    middle: Floats
    """(3,), in the frame that the surface was given in."""
    eye: Floats | None
    """(3,): the scanner in the frame of the samples, if all of them were seen from one place and it is known."""

    @cached_property
    def tree(self) -> "scipy.spatial.cKDTree":
        """The search tree of the samples."""
        return scipy.spatial.cKDTree(self.fine.points)

    @cached_property
    def free(self) -> FreeSpace | None:
        """The space that the scanner looked through."""
        return None if self.eye is None else FreeSpace.of(self.fine.points, self.eye)

    @cached_property
    def judged(self) -> SampledSurface:
        """The samples that hypotheses are judged by."""
        return self.fine.some(MANY_SAMPLES)

    @cached_property
    def bounds(self) -> Floats:
        """Planes (P, 4), normals and offsets n · x, behind which there is hardly anything: walls, faces of a block.

        Wherever such planes coincide, something of the same outline does, its mirror image included.
        """
        some, reach = self.judged, 0.5 * self.fine.cell + _SIGMAS * self.fine.noise
        facets = Facets(some.points, some.normals, np.full(len(some), reach))
        bounds = []
        for plane in grow_planes(facets, _BOUNDS, max(12, _LEAST_BOUND * len(some))):
            height = plane.heights(some.points)
            if min(np.mean(height > self.off_bounds), np.mean(height < -self.off_bounds)) < _BEHIND:
                bounds.append([*plane.normal, plane.offset])
        return np.array(bounds).reshape(-1, 4)

    @property
    def off_bounds(self) -> float:
        """Distance from a plane, below which samples belong to it."""
        return _ON_BOUND * self.fine.cell + _SIGMAS * self.fine.noise

    def is_inside(self, points: Floats) -> Bools:
        """Which of its points (N, 3) are on none of the planes that bound it."""
        heights = points @ self.bounds[:, :3].T - self.bounds[:, 3]
        inside: Bools = np.all(np.abs(heights) > self.off_bounds, axis=1)
        return inside

    @property
    def mirrored(self) -> "SurfaceSide":
        """Its mirror image, x reversed."""
        fine = replace(self.fine, points=_MIRROR * self.fine.points, normals=_MIRROR * self.fine.normals)
        return SurfaceSide(fine, _MIRROR * self.middle, None if self.eye is None else _MIRROR * self.eye)


@dataclass(frozen=True, eq=False)
class SurfacePair:
    """Both surfaces: `first` in its own unit; of `second`, the points as they are given, which `scaled` resamples."""

    first: SurfacePoints
    second: SurfacePoints
    spacings: tuple[float, float]
    noises: tuple[float, float]

    @classmethod
    def of(cls, first: SurfacePoints, second: SurfacePoints) -> "SurfacePair":
        """Thinned out if they are large, with their noise."""
        first, second = _thinned(first), _thinned(second)
        noises = [measured_noise(side.points) if side.noise is None else side.noise for side in (first, second)]
        return cls(first, second, (spacing_of(first.points), spacing_of(second.points)), (noises[0], noises[1]))

    def scaled(self, scale: float) -> "ScaledPair":
        """Samples of both in the first one's unit. Raises ValueError for too few."""
        points = scale * self.second.points
        middles = np.median(self.first.points, axis=0), np.median(points, axis=0)
        extent = min(extent_of(evenly_spread(side, _EXTENT_SAMPLE)) for side in (self.first.points, points))
        spacing = max(self.spacings[0], scale * self.spacings[1])
        fine = max(extent / _FINE, _SPACINGS * spacing)
        coarse = max(extent / ACROSS, fine)
        noises = self.noises[0], scale * self.noises[1]
        sides = [
            SurfaceSide(sample_surface(given - middle, normals, fine, noise), middle, eye)
            for given, normals, middle, noise, eye in zip(
                (self.first.points, points),
                (self.first.normals, self.second.normals),
                middles,
                noises,
                (_from(self.first.eye, middles[0]), _from(self.second.eye, middles[1], scale)),
                strict=True,
            )
        ]
        for _ in range(_COARSENINGS):
            count = max(len(side.fine.coarser(coarse)) for side in sides)
            if count <= _MOST_COARSE:
                break
            coarse *= 1.1 * float(np.sqrt(count / _MOST_COARSE))
        return ScaledPair(sides[0], sides[1], coarse, scale, self.first.is_closed or self.second.is_closed)


@dataclass(frozen=True, eq=False)
class ScaledPair:
    """Samples of both surfaces, in the unit of the first."""

    first: SurfaceSide
    second: SurfaceSide
    coarse: float
    """Edge of a coarse cell."""
    scale: float
    """Factor of the second one's lengths."""
    has_closed: bool = False
    """Whether one of the two is all of a body's surface."""

    @property
    def tolerance(self) -> float:
        """Largest distance of samples that coincide."""
        variance = sum(
            side.fine.noise**2 / max(1.0, median(side.fine.count.astype(np.float64)))
            for side in (self.first, self.second)
        )
        return _NOISES * float(np.sqrt(variance)) + _OF_CELL * self.first.fine.cell


def _thinned(side: SurfacePoints) -> SurfacePoints:
    if len(side.points) <= _MOST_POINTS:
        return side
    normals = None if side.normals is None else evenly_spread(side.normals, _MOST_POINTS)
    noise = measured_noise(side.points) if side.noise is None else side.noise
    return replace(side, points=evenly_spread(side.points, _MOST_POINTS), normals=normals, noise=noise)


def _from(eye: Floats | None, middle: Floats, scale: float = 1.0) -> Floats | None:
    """Where the scanner is in the frame of the middle."""
    return None if eye is None else scale * eye - middle


def rescaled(sides: ScaledPair, factor: float) -> ScaledPair:
    """With the second surface enlarged."""
    if factor == 1.0:
        return sides
    second = sides.second
    fine = replace(second.fine, points=factor * second.fine.points, noise=factor * second.fine.noise)
    eye = None if second.eye is None else factor * second.eye
    return replace(sides, second=SurfaceSide(fine, factor * second.middle, eye), scale=factor * sides.scale)


def on_surface(sides: ScaledPair) -> ScaledPair:
    """With samples that are on the surfaces, away from their borders."""
    first, second = (
        replace(side, fine=side.fine.on_surface(with_borders=False)) for side in (sides.first, sides.second)
    )
    return replace(sides, first=first, second=second)
