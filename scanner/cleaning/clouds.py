"""A cloud while steps are done to it, and the steps of its points: which are kept, where they are, in which axes.

Smoothing by what is known of the noise: points move along their normals to a quadratic surface among neighbours.

Neighbours weigh by their variances, and less the less they fit to it (Tukey's biweight), so that those beyond
an edge do not count. As much of a move is made as the scatter of the neighbours is noise (Lee, "Digital image
enhancement and noise filtering by use of local statistics", 1980): none where they are apart by form.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Bools, Floats, Ints
from scanner.configuration import CloudStep
from scanner.errors import InputError
from scanner.quantities import parse_coordinates, parse_length, unit_name

_NEIGHBOURS_OF_PLANE = 48
_AT_ONCE = 20_000
_ITERATIONS = 4
_CUT = 4.0  # standard deviations beyond which a neighbour does not count
_FARTHEST = 5.0  # standard deviations that one neighbour counts for in the scatter
_MOST = 3.0  # standard deviations that a point moves at most
_TERMS = 6  # of a quadratic surface
_RIDGE = 1e-9
_LEAST_ALIKE = 0.9  # cosine of the angle between normals of one surface
_LEAST_SHARE = 0.5  # of the neighbours that have to be of the surface, for a point to move
OF_MESH = ("fill", "triangles")  # which change a mesh, and no points

_NEIGHBOURS_OF_OUTLIER = 20
_SAMPLE = 20_000
# Points are of one piece if a chain of cells leads from one to the other, whose edge is so many median spacings.
_GAP = 4.0
_LEAST_AXES = 1e-9


def smoothed(points: Floats, normals: Floats, sigma_along: Callable[[slice, Floats], Floats]) -> Floats:
    """Points (N, 3) moved along their `normals` (N, 3), whose standard deviation along them `sigma_along` says of
    each part of the points and its normals.
    """
    count = min(_NEIGHBOURS_OF_PLANE, len(points))
    if count <= _TERMS:
        return points
    parts = [slice(start, min(start + _AT_ONCE, len(points))) for start in range(0, len(points), _AT_ONCE)]
    sigma = np.concatenate([sigma_along(part, normals[part]) for part in parts])
    tree = scipy.spatial.cKDTree(points)
    moved = points.copy()
    for part in parts:
        _, near = tree.query(points[part], count)
        moved[part] += _steps(points, normals, sigma, part, np.asarray(near, np.int64))[:, None] * normals[part]
    return moved


def _steps(points: Floats, normals: Floats, sigma: Floats, part: slice, near: Ints) -> Floats:
    """How far the points of a part (n) move along their normals, from their neighbours `near` (n, k)."""
    normal, own = normals[part], sigma[part]
    apart = points[near] - points[part][:, None]
    height = np.einsum("nki,ni->nk", apart, normal)
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    u, v = (np.einsum("nki,ni->nk", apart, axis) for axis in (across, np.cross(normal, across)))
    reach = np.maximum(np.max(np.hypot(u, v), axis=1, keepdims=True), 1e-30)
    u, v = u / reach, v / reach
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    variance = sigma[near] ** 2
    alike = np.einsum("nki,ni->nk", normals[near], normal) > _LEAST_ALIKE
    prior = np.where(alike, 1 / variance, 0.0)
    weight, residual, step = prior, height, np.zeros(len(normal))
    for _ in range(_ITERATIONS):
        weighted = weight[..., None] * design
        matrix = np.einsum("nki,nkj->nij", weighted, design)
        ridge = _RIDGE * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(_TERMS)
        fit = np.linalg.solve(
            matrix + ridge + 1e-300 * np.eye(_TERMS), np.einsum("nki,nk->ni", weighted, height)[..., None]
        )
        residual, step = height - (design @ fit)[..., 0], fit[:, 0, 0]
        weight = np.clip(1 - residual**2 / (_CUT**2 * variance), 0.0, None) ** 2 * prior
    scatter = np.mean(np.minimum(residual**2 / variance, _FARTHEST**2), axis=1)  # over noise; 1 on a surface
    enough = np.count_nonzero(weight > 0, axis=1) >= _LEAST_SHARE * near.shape[1]
    step = np.where(enough, step / np.maximum(scatter, 1.0), 0.0)
    steps: Floats = np.clip(step, -_MOST * own, _MOST * own)
    return steps


@dataclass(frozen=True, eq=False)
class WorkedCloud:
    """A cloud between two steps."""

    unit: str
    """Of all lengths."""
    points: Floats
    """(N, 3) in the axes of `frame`."""
    normals: Floats
    """(N, 3) in the same axes."""
    number: Ints
    """Which points of the whole cloud these are, (N,)."""
    frame: Pose
    """X = frame @ X_result."""
    moved: bool
    """Whether points were moved by more than the change of axes."""
    covariances: Callable[[Ints], Floats] | None
    """Of the points of these numbers (K,), in the result's axes, (K, 3, 3); None where they are not known."""
    floor: Callable[[], Pose]
    """The axes of the floor, from the result's. Raises InputError if there is none."""

    def __len__(self) -> int:
        return len(self.points)

    def kept(self, which: Bools | Ints) -> "WorkedCloud":
        """A part of the points."""
        return replace(self, points=self.points[which], normals=self.normals[which], number=self.number[which])

    def turned(self, to: Pose) -> "WorkedCloud":
        """In other axes, X_new = to @ X."""
        return replace(self, points=to @ self.points, normals=to.rotate(self.normals), frame=to @ self.frame)


def do_steps(cloud: WorkedCloud, steps: Sequence[CloudStep]) -> list[WorkedCloud]:
    """The cloud after each step. Raises InputError that names the step that cannot be done or leaves nothing."""
    clouds: list[WorkedCloud] = []
    for step in steps:
        try:
            done = _STEPS[step.name](cloud, step) if step.name in _STEPS else cloud
        except InputError as error:
            raise InputError(f"step '{step}': {error}") from error
        if not len(done):
            raise InputError(f"step '{step}': leaves none of {len(cloud):,} points; {_reach(cloud)}")
        clouds.append(done)
        cloud = done
    return clouds


def _reach(cloud: WorkedCloud) -> str:
    low, high = (", ".join(f"{value:.4g}" for value in edge) for edge in (cloud.points.min(0), cloud.points.max(0)))
    return f"they reach from ({low}) to ({high}) in {unit_name(cloud.unit)}"


def inside_box(points: Floats, text: str, unit: str) -> Bools:
    """Which points (N, 3) are in the box that is described, (N,): two corners, and, unless it is along the points'
    axes, its own axes as of `axes_of`. Raises InputError if it is none.
    """
    parts = text.split(",")
    if len(parts) == 6 + 9:
        text, points = ",".join(parts[:6]), axes_of(",".join(parts[6:]), unit) @ points
    corners = np.array(parse_coordinates(text, unit, 6)).reshape(2, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if np.any(low == high):
        raise InputError("expected two opposite corners of a box, found two that have a coordinate in common")
    inside: Bools = np.all((points >= low) & (points <= high), axis=1)
    return inside


def length_of(step: CloudStep, unit: str) -> float:
    """A step's length in a unit. Raises InputError."""
    return parse_length(str(step.parameter), unit)


def axes_of(text: str, unit: str) -> Pose:
    """The axes through three points, X_new = pose @ X. Raises InputError if they are on a line."""
    origin, along, beside = np.array(parse_coordinates(text, unit, 9)).reshape(3, 3)
    x, z = along - origin, np.cross(along - origin, beside - origin)
    size = float(np.linalg.norm(along - origin) * np.linalg.norm(beside - origin))
    if not np.linalg.norm(z) > _LEAST_AXES * size:
        raise InputError("expected an origin, a point on the x axis and one beside it, found three points on a line")
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])
    return Pose(rotation, -rotation @ origin)


def spacing_of(points: Floats) -> float:
    """Median distance of points (N, 3) from their nearest neighbours."""
    if len(points) < 2:
        return 0.0
    some = points[:: max(1, len(points) // _SAMPLE)]
    apart = np.asarray(scipy.spatial.cKDTree(points).query(some, 2)[0])[:, 1]
    return float(np.median(apart))


def _box(cloud: WorkedCloud, step: CloudStep) -> WorkedCloud:
    return cloud.kept(inside_box(cloud.points, str(step.box), cloud.unit))


def _outliers(cloud: WorkedCloud, step: CloudStep) -> WorkedCloud:
    o3d = open3d()
    whole = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points))
    _, kept = whole.remove_statistical_outlier(_NEIGHBOURS_OF_OUTLIER, float(step.parameter))
    return cloud.kept(np.sort(np.asarray(kept, np.int64)))


def _pieces(cloud: WorkedCloud, step: CloudStep) -> WorkedCloud:
    least, edge = length_of(step, cloud.unit), _GAP * spacing_of(cloud.points)
    if edge == 0:
        return cloud
    cells, of_cell = np.unique(np.floor(cloud.points / edge).astype(np.int64), axis=0, return_inverse=True)
    first, second = (
        scipy.spatial.cKDTree(cells).query_pairs(1.8, output_type="ndarray").T
    )  # cells that share a corner: up to √3
    shape = (len(cells), len(cells))
    joined = scipy.sparse.coo_matrix((np.ones(len(first), np.bool_), (first, second)), shape)
    count, of_piece = scipy.sparse.csgraph.connected_components(joined, directed=False)
    piece = of_piece[of_cell.reshape(-1)]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, cloud.points)
    np.maximum.at(high, piece, cloud.points)
    large = np.linalg.norm(high - low, axis=1) >= least
    return cloud.kept(large[piece])


def _smooth(cloud: WorkedCloud, _: CloudStep) -> WorkedCloud:
    if cloud.covariances is None:
        raise InputError(
            "a joint cloud has no standard deviation of single points, and what stations share is averaged in it "
            "already; smooth the result of one capture"
        )
    axes = cloud.frame.rotation

    def sigma_along(chosen: slice, normals: Floats) -> Floats:
        assert cloud.covariances is not None
        directions = normals @ axes  # of the result's axes
        covariance = cloud.covariances(cloud.number[chosen])
        along: Floats = np.sqrt(np.einsum("ni,nij,nj->n", directions, covariance, directions))
        return along

    return replace(cloud, points=smoothed(cloud.points, cloud.normals, sigma_along), moved=True)


def _floor(cloud: WorkedCloud, _: CloudStep) -> WorkedCloud:
    return cloud.turned(cloud.floor() @ cloud.frame.inverse())


def _axes(cloud: WorkedCloud, step: CloudStep) -> WorkedCloud:
    return cloud.turned(axes_of(str(step.axes), cloud.unit))


_STEPS: dict[str, Callable[[WorkedCloud, CloudStep], WorkedCloud]] = {
    "box": _box,
    "outliers": _outliers,
    "pieces": _pieces,
    "smooth": _smooth,
    "floor": _floor,
    "axes": _axes,
}
