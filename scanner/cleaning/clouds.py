"""A cloud while steps are done to it, and the steps of its points: which are kept, where they are, in which axes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Bools, Floats, Ints
from scanner.cleaning.smoothing import smoothed
from scanner.configuration import CloudStep
from scanner.errors import InputError
from scanner.quantities import parse_coordinates, parse_length, unit_name

OF_MESH = ("fill", "triangles")  # which change a mesh, and no points

_NEIGHBOURS = 20
_SAMPLE = 20_000
# Points are of one piece if a chain of cells leads from one to the other, whose edge is so many median spacings.
_GAP = 4.0
_LEAST_AXES = 1e-9


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
    _, kept = whole.remove_statistical_outlier(_NEIGHBOURS, float(step.parameter))
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
