"""Two surfaces of any origin, sampled alike, with their middles at the origin."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from calib.numerics import Floats, evenly_spread, median
from calib.registration.free_space import FreeSpace
from calib.registration.sampled_surface import SampledSurface, extent_of, measured_noise, sample_surface, spacing_of

MANY_SAMPLES, ALL_SAMPLES = 4000, 16_000  # by which hypotheses are judged, and the last ones
ACROSS = 40.0  # coarse cells across the smaller surface
_MOST_POINTS, _EXTENT_SAMPLE = 400_000, 20_000
_FINE = 160.0  # fine cells across the smaller surface
_MOST_COARSE, _COARSENINGS = 40_000, 3  # samples of the larger surface; attempts to have no more
_SPACINGS = 1.5  # least edge of a fine cell, in distances of neighbouring points
_NOISES, _OF_CELL = 4.0, 0.2  # tolerance: standard deviations of samples, and share of a fine cell


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


@dataclass(frozen=True, eq=False)
class SurfaceSide:
    """A surface with its middle at the origin, and the search tree of its fine samples."""

    fine: SampledSurface
    tree: "scipy.spatial.cKDTree"
    middle: Floats
    free: FreeSpace | None

    @cached_property
    def judged(self) -> SampledSurface:
        """The samples that hypotheses are judged by."""
        return self.fine.some(MANY_SAMPLES)

    @classmethod
    def of(cls, surface: SampledSurface, middle: Floats, eye: Floats | None) -> "SurfaceSide":
        """`eye` in the same frame as the samples."""
        free = None if eye is None else FreeSpace.of(surface.points, eye)
        return cls(surface, scipy.spatial.cKDTree(surface.points), middle, free)


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
            SurfaceSide.of(sample_surface(given - middle, normals, fine, noise), middle, eye)
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
        return ScaledPair(sides[0], sides[1], coarse, scale)


@dataclass(frozen=True, eq=False)
class ScaledPair:
    """Samples of both surfaces, in the unit of the first."""

    first: SurfaceSide
    second: SurfaceSide
    coarse: float
    """Edge of a coarse cell."""
    scale: float
    """Factor of the second one's lengths."""

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
    return SurfacePoints(evenly_spread(side.points, _MOST_POINTS), normals, noise, side.eye)


def _from(eye: Floats | None, middle: Floats, scale: float = 1.0) -> Floats | None:
    """Where the scanner is in the frame of the middle."""
    return None if eye is None else scale * eye - middle


def rescaled(sides: ScaledPair, factor: float) -> ScaledPair:
    """With the second surface enlarged."""
    if factor == 1.0:
        return sides
    second = sides.second
    fine = replace(second.fine, points=factor * second.fine.points, noise=factor * second.fine.noise)
    eye = None if second.free is None else factor * second.free.eye
    return replace(sides, second=SurfaceSide.of(fine, factor * second.middle, eye), scale=factor * sides.scale)


def on_surface(sides: ScaledPair) -> ScaledPair:
    """With samples that are on the surfaces."""
    first, second = (
        SurfaceSide.of(side.fine.on_surface(), side.middle, None if side.free is None else side.free.eye)
        for side in (sides.first, sides.second)
    )
    return replace(sides, first=first, second=second)
