"""Surfaces without pixels, sampled evenly: clouds and meshes of any origin, as their registration compares them.

A cell of a grid holds at most one sample: the mean of its points and normals. Where normals are not known, planes
through neighbours give them, and their signs are made to agree along the surface (Hoppe et al., "Surface reconstruction
from unorganized points", 1992).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from calib.deferred_imports import open3d
from calib.geometry import cross
from calib.numerics import Bools, Floats, Ints, evenly_spread, is_far, median, processors
from calib.pointcloud import scattered_surface
from calib.registration.projection import Patches

_WELDED = 1e-7  # of a mesh's extent: corners nearer to each other are one
_NEIGHBOURS = 12  # of a point, for planes through them
_NOISE_SAMPLE = 3000  # points
_LOCAL_SAMPLE, _LOCAL = 12_000, 24  # points where noise is measured, and neighbouring ones whose median it is
_OF_NOISE = 8  # neighbours of the planes that noise is measured by: with more, curvature would be noise
_MEDIAN_SQUARE = 0.870  # median of χ² over its five degrees of freedom
_OF_BENT, _MEDIAN_SQUARE_BENT = 12, 0.891  # the same of curved surfaces, with six degrees of freedom
_LEAST_NORMAL = 0.5  # length of a mean normal: shorter where two sides of something thin share a cell
_MOST_OPPOSED = 0.05  # share of neighbours with opposed normals, beyond which the signs of given normals are not used
_CREASE, _MOST_CREASES = 0.12, 0.4  # radians of neighbouring normals; least share of samples away from creases
_BORDER = 0.4  # from a sample to its neighbours' middle, over their spread: 0.2 in a surface, 0.75 at a straight border
_LEAN = 0.1  # of a sample's noise: what the tilted normal of a border may add a cell beside it
_ORIENTED, _ORIENTATION_NEIGHBOURS = 4000, 12
_FLAT = 1e-6  # thickness relative to the extent, below which points are on a plane, or a line
_FOR_THREADS = 2000  # points, from which a search in threads is worth it
_SLOT = 1 << 21  # cells along an axis that a number of a cell has room for


@dataclass(frozen=True, eq=False)
class SampledSurface:
    """One sample for each cell of a grid."""

    points: Floats
    """(N, 3): means of the points in each cell."""
    normals: Floats
    """(N, 3), of unit length."""
    count: Ints
    """(N,): points in each cell."""
    spread: Floats
    """(N,): mean squared distance of a cell's points from their mean."""
    cell: float
    """Edge of a cell."""
    noise: float
    """Standard deviation of a single point along the normal."""
    is_oriented: bool
    """Whether normals point to the side from which the surface was seen; otherwise all of them may point away."""

    def __len__(self) -> int:
        return len(self.points)

    @property
    def patches(self) -> Patches:
        """The samples, for compiled loops."""
        return Patches(self.points, self.normals)

    @property
    def flipped(self) -> "SampledSurface":
        """With normals of the other sign."""
        return replace(self, normals=-self.normals)

    @property
    def extent(self) -> float:
        """How large it is: the diagonal of the box that holds the middle 96 % along each axis."""
        return extent_of(self.points)

    def some(self, count: int) -> "SampledSurface":
        """`count` of the samples, at random, but the same every time."""
        if len(self) <= count:
            return self
        chosen = np.random.default_rng(0).permutation(len(self))[:count]
        return self.part(chosen)

    def part(self, chosen: Ints | Bools) -> "SampledSurface":
        """Some of the samples."""
        return replace(
            self,
            points=self.points[chosen],
            normals=self.normals[chosen],
            count=self.count[chosen],
            spread=self.spread[chosen],
        )

    def coarser(self, cell: float) -> "SampledSurface":
        """Sampled again with larger cells."""
        points, normals, count, spread = _means(self.points, self.normals, self.count, cell)
        return replace(self, points=points, normals=normals, count=count, spread=spread, cell=cell)

    def on_surface(self, *, with_borders: bool = True) -> "SampledSurface":
        """The samples away from creases, moved from the mean of their points onto the curved surface.

        The mean of points on z = ½ xᵀ K x is ½ tr(K S) off it, for their covariance S along the surface. Normals turn
        by −K x, so that the covariance of points and normals of neighbours has the trace −tr(K P), for their covariance
        P. Where all neighbours are on one side, the normal is that of a place beside the sample, and what lies beyond
        the border would be compared with a tilted plane.
        """
        index = scipy.spatial.cKDTree(self.points).query(self.points, _NEIGHBOURS, workers=processors())[1]
        apart, turned = (
            values[index] - values[index].mean(axis=1, keepdims=True) for values in (self.points, self.normals)
        )
        area = np.mean(np.sum(apart**2, axis=2), axis=1)
        bend = np.mean(np.sum(apart * turned, axis=2), axis=1)
        along = np.maximum(0.0, self.spread - self.noise**2 * (1 - 1 / np.maximum(self.count, 1)))
        off = -0.5 * bend * along / np.maximum(area, 1e-300)
        smooth = np.mean(np.sum(turned**2, axis=2), axis=1) < _CREASE**2
        aside = np.linalg.norm(self.points[index].mean(axis=1) - self.points, axis=1)
        lean = 0.5 * self.cell * aside * np.abs(bend) / np.maximum(area, 1e-300)
        is_tilted = (aside > _BORDER * np.sqrt(area)) & (lean > _LEAN * self.noise / np.sqrt(self.count))
        smooth &= with_borders | ~is_tilted
        moved = replace(self, points=self.points - off[:, None] * self.normals)
        return moved.part(smooth) if np.mean(smooth) > _MOST_CREASES else moved


def sample_surface(points: Floats, normals: Floats | None, cell: float, noise: float | None = None) -> SampledSurface:
    """The surface through points (N, 3), with normals (N, 3) if they are known; `noise` of the points, measured if
    None.

    Raises ValueError for fewer than `_NEIGHBOURS` cells, and ImportError if signs are needed and Open3D is missing.
    """
    noise = measured_noise(points) if noise is None else noise
    known = normals if normals is not None and _are_usable(normals) else None
    if known is None:
        means, _, count, spread = _means(points, np.broadcast_to([0.0, 0.0, 1.0], points.shape), None, cell)
        _require(means, points, cell)
        return SampledSurface(means, _normals_of(means), count, spread, cell, noise, False)
    means, directions, count, spread = _means(points, known, None, cell)
    _require(means, points, cell)
    if are_opposed(means, directions):
        return SampledSurface(means, _normals_of(means), count, spread, cell, noise, False)
    return SampledSurface(means, directions, count, spread, cell, noise, True)


def _normals_of(points: Floats) -> Floats:
    """Normals (N, 3) whose signs agree along the surface. Raises ValueError if the points (N, 3) are on one line."""
    extents, axes = np.linalg.eigh(np.cov(points.T))
    if extents[1] < _FLAT**2 * extents[2]:
        raise ValueError("the points of one of them are on a line, and show no surface")
    near = points - (points.min(axis=0) - np.ptp(points, axis=0).max()) if is_far(points) else points
    normals: Floats = scattered_surface(near[None].astype(np.float32)).normals[0].astype(np.float64)
    if extents[0] < _FLAT**2 * extents[2]:  # on a plane: there are no tetrahedra between the points
        normals *= np.where(normals @ axes[:, 0] < 0, -1.0, 1.0)[:, None]
        return normals
    return _oriented(near, normals)


@dataclass(frozen=True, eq=False)
class SamplePairs:
    """The nearest samples of a surface to N points with normals."""

    apart: Floats
    """(N,): distance; infinite beyond the reach of the search, where nothing else has a meaning."""
    nearest: Ints
    """(N,): number of the sample."""
    own: Floats
    """(N, 3): its normal."""
    normals: Floats
    """(N, 3): the mean of both normals, which is exact to the second order where surfaces are curved."""
    cosine: Floats
    """(N,): of both normals."""
    along: Floats
    """(N,): signed distance along `normals`."""
    aside: Floats
    """(N,): distance across them."""


def pair_samples(
    surface: SampledSurface,
    tree: "scipy.spatial.cKDTree[Any, Any]",
    points: Floats,
    normals: Floats,
    reach: float,
    *,
    turn_points: bool = False,
    turn_samples: bool = False,
) -> SamplePairs:
    """The samples of a surface nearest to points (N, 3) with normals (N, 3), at most `reach` away.

    `turn_points`, `turn_samples`: whose normals, of unknown sign, are turned to the side of the other's.
    """
    workers = processors() if len(points) > _FOR_THREADS else 1
    apart, nearest = tree.query(points, distance_upper_bound=reach, workers=workers)
    nearest = np.where(np.isfinite(apart), nearest, 0).astype(np.int64)
    own = surface.normals[nearest]
    sign = np.where(np.sum(own * normals, axis=1) < 0, -1.0, 1.0)[:, None]
    own, normals = sign * own if turn_samples else own, sign * normals if turn_points else normals
    middle = own + normals
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-9)
    off = points - surface.points[nearest]
    along = np.sum(off * middle, axis=1)
    aside = np.sqrt(np.maximum(0.0, np.sum(off**2, axis=1) - along**2))
    return SamplePairs(np.asarray(apart), nearest, own, middle, np.sum(own * normals, axis=1), along, aside)


def extent_of(points: Floats, outside: float = 0.02) -> float:
    """How large a cloud (N, 3) is: the diagonal of the box that holds it, but for a share `outside` at either end."""
    low, high = np.quantile(points, (outside, 1 - outside), axis=0)
    return float(np.linalg.norm(high - low))


def spacing_of(points: Floats) -> float:
    """Median distance of neighbouring points (N, 3) along a surface: the third nearest is half as far again."""
    tree = scipy.spatial.cKDTree(points, balanced_tree=False, compact_nodes=False)
    return median(np.asarray(tree.query(evenly_spread(points, _NOISE_SAMPLE), 4)[0])[:, -1]) / 1.5


def measured_noise(points: Floats) -> float:
    """Standard deviation of points (N, 3) from planes through their neighbours; 0 for too few."""
    if len(points) < 2 * _NEIGHBOURS:
        return 0.0
    return float(np.sqrt(median(_from_planes(points, evenly_spread(points, _NOISE_SAMPLE))) / _MEDIAN_SQUARE))


def local_noise(points: Floats, places: Floats) -> Floats:
    """Standard deviations (M,) of points (N, 3) from curved surfaces through their neighbours, around places (M, 3).

    Noise grows with the distance from the scanner and with the slant: one number for a cloud would be too small far
    away. Where a surface bends away from the scanner, its points are far apart, and planes through them would add half
    as much again.
    """
    if len(points) < 2 * _OF_BENT:
        return np.zeros(len(places))
    some = evenly_spread(points, _LOCAL_SAMPLE)
    squares = _from_quadrics(points, some)
    tree = scipy.spatial.cKDTree(some)
    around = np.asarray(tree.query(some, min(_LOCAL, len(some)))[1])
    typical = np.median(squares[around], axis=1) / _MEDIAN_SQUARE_BENT
    noise: Floats = np.sqrt(typical)[np.asarray(tree.query(places)[1])]
    return noise


def _from_planes(points: Floats, some: Floats) -> Floats:
    """Mean squared distances (M,), as of one point, from the planes through the neighbours of `some` points (M, 3)."""
    _, index = scipy.spatial.cKDTree(points, balanced_tree=False, compact_nodes=False).query(some, _OF_NOISE)
    around = points[index] - points[index].mean(axis=1, keepdims=True)
    squares: Floats = np.linalg.eigvalsh(np.matmul(around.transpose(0, 2, 1), around))[:, 0]
    return np.maximum(squares, 0.0) / (_OF_NOISE - 3)


def _from_quadrics(points: Floats, some: Floats) -> Floats:
    """The same from surfaces of the second degree."""
    _, index = scipy.spatial.cKDTree(points, balanced_tree=False, compact_nodes=False).query(some, _OF_BENT)
    around = points[index] - points[index].mean(axis=1, keepdims=True)
    axes = np.linalg.eigh(np.matmul(around.transpose(0, 2, 1), around))[1]
    height, u, v = np.moveaxis(around @ axes, 2, 0)
    size = np.sqrt(np.mean(u**2 + v**2, axis=1, keepdims=True)) + 1e-300
    u, v = u / size, v / size
    basis = np.linalg.qr(np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2))[0]
    fitted = np.einsum("nki,nli,nl->nk", basis, basis, height)
    squares: Floats = np.sum((height - fitted) ** 2, axis=1) / (_OF_BENT - 6)
    return squares


def _require(means: Floats, points: Floats, cell: float) -> None:
    if len(means) <= _NEIGHBOURS:
        raise ValueError(
            f"both are compared in cells {cell:.3g} wide, after the spacing of the sparser one; "
            f"{len(points):,} points, {extent_of(points, 0.0):.3g} across, cover {len(means)} cells, "
            f"expected more than {_NEIGHBOURS}: is one of them in another unit, or too sparse?"
        )


def _are_usable(normals: Floats) -> bool:
    length = np.linalg.norm(evenly_spread(normals, _NOISE_SAMPLE), axis=1)
    return bool(np.mean(np.abs(length - 1) < 0.1) > 1 - _MOST_OPPOSED)


def _means(points: Floats, normals: Floats, count: Ints | None, cell: float) -> tuple[Floats, Floats, Ints, Floats]:
    """Mean points and normals (M, 3) of the cells, how many points they are, and how far these are spread, (M,)."""
    least = points.min(axis=0)
    points = points - least  # squares of what is far from the origin would have lost the spread
    _, of_cell = np.unique(cell_numbers(points, cell, np.zeros(3)), return_inverse=True)
    weight = np.ones(len(points)) if count is None else count.astype(np.float64)
    total = np.bincount(of_cell, weight)
    middle = np.stack([np.bincount(of_cell, weight * column) for column in points.T], axis=1) / total[:, None]
    normal = np.stack([np.bincount(of_cell, weight * column) for column in normals.T], axis=1) / total[:, None]
    square = np.bincount(of_cell, weight * np.sum(points**2, axis=1)) / total
    spread = np.maximum(0.0, square - np.sum(middle**2, axis=1))
    length = np.linalg.norm(normal, axis=1)
    one_sided: Bools = length > _LEAST_NORMAL
    normal = normal[one_sided] / length[one_sided, None]
    return middle[one_sided] + least, normal, np.rint(total[one_sided]).astype(np.int64), spread[one_sided]


def cell_numbers(points: Floats, edge: float, origin: Floats) -> Ints:
    """Numbers (N,) of the cubes that points (N, 3) are in; a corner of one is the `origin` (3,)."""
    place = np.floor((points - origin) / edge).astype(np.int64)
    place -= place.min(axis=0)
    numbers: Ints = (place[:, 0] * _SLOT + place[:, 1]) * _SLOT + place[:, 2]
    return numbers


def are_opposed(points: Floats, normals: Floats) -> bool:
    """Whether normals (N, 3) of points (N, 3) change their signs along the surface, as of a mesh with flipped faces."""
    chosen = np.arange(0, len(points), max(1, len(points) // _NOISE_SAMPLE))
    _, index = scipy.spatial.cKDTree(points).query(points[chosen], 4)
    cosine = np.einsum("ni,nki->nk", normals[chosen], normals[np.asarray(index)[:, 1:]])
    return bool(np.mean(cosine < -0.7) > _MOST_OPPOSED)


def _oriented(points: Floats, normals: Floats) -> Floats:
    """Normals (N, 3) whose signs agree along the surface; which of the two sides they are on is not known."""
    o3d = open3d()
    chosen = np.random.default_rng(0).permutation(len(points))[:_ORIENTED]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[chosen]))
    cloud.normals = o3d.utility.Vector3dVector(normals[chosen])
    cloud.orient_normals_consistent_tangent_plane(_ORIENTATION_NEIGHBOURS)
    agreed = np.asarray(cloud.normals)
    nearest = np.asarray(scipy.spatial.cKDTree(points[chosen]).query(points)[1])
    sign = np.where(np.sum(normals * agreed[nearest], axis=1) < 0, -1.0, 1.0)
    return normals * sign[:, None]


def is_closed(vertices: Floats, triangles: Ints) -> bool:
    """Whether a mesh is all of one or several bodies' surface: every edge belongs to an even number of triangles.

    Corners in one place, as each triangle of an STL file has its own, are one.
    """
    grid = max(extent_of(vertices, 0.0) * _WELDED, np.finfo(np.float64).tiny)
    _, welded = np.unique(np.rint(vertices / grid).astype(np.int64), axis=0, return_inverse=True)
    corners = welded.reshape(-1)[triangles]
    others = np.roll(corners, 1, axis=1)
    whole = (corners != others).all(axis=1)
    edges = (np.minimum(corners, others) * len(vertices) + np.maximum(corners, others))[whole]
    counts = np.unique(edges, return_counts=True)[1]
    return len(counts) > 0 and bool(np.all(counts % 2 == 0))


def enclosed_volume(vertices: Floats, triangles: Ints) -> float:
    """The volume in a closed mesh, negative if its triangles run counter-clockwise as seen from within."""
    a, b, c = (vertices[triangles[:, k]] - vertices[0] for k in range(3))
    return float(np.sum(a * cross(b, c))) / 6


def sample_mesh(vertices: Floats, triangles: Ints, count: int) -> tuple[Floats, Floats]:
    """Points (count, 3), evenly spread over the area of a mesh but the same every time, and the triangles' normals
    there.

    Normals are on the side from which the corners of a triangle run counter-clockwise.
    """
    rng = np.random.default_rng(0)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    facing = np.cross(b - a, c - a)
    area = np.linalg.norm(facing, axis=1)
    edges = np.cumsum(area)
    at = (np.arange(count) + rng.random(count)) / count * edges[-1]
    chosen = np.minimum(np.searchsorted(edges, at, side="right"), len(area) - 1)
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points: Floats = a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
    return points, facing[chosen] / area[chosen, None]
