"""What a projector lights, pixel by pixel, seen from its own eye through its own lens."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints, compiled, in_slices
from scanner.exporting.mapping.wall import WallView
from scanner.exporting.triangles import Mesh, open3d
from scanner.io import RowFile, StoredDevice, row_bands

Numbers = NDArray[np.float32]

_SLICE_PIXELS = 1 << 16  # worked on by one processor
_SIZED_PIXELS = 1 << 20  # whose size on the wall is measured
_GRAZING = np.sin(np.radians(10.0))  # surfaces seen at a smaller angle show streaks


@dataclass(frozen=True, eq=False)
class WallPart:
    """What a projector lights of the wall: the smallest and the largest coordinates (2,) along the wall's axes,
    infinite if nothing, and the median side of a pixel, NaN if none is known.
    """

    low: Floats
    high: Floats
    pixel: float


@dataclass(frozen=True, eq=False)
class ProjectorView:
    """Of each pixel of `projector`: `depth` (H, W) along the projector's axis, `position` (H, W, 3) of what it lights,
    in the unit and the axes of the files, 0 where it lights nothing that was measured; `on_wall` (H, W, 2), where the
    viewer sees that on the wall, along its axes, NaN where that is nowhere.

    `nearest`, `farthest`: the range of the depth; (inf, 0) if nothing is lit.
    """

    projector: StoredDevice
    depth: RowFile
    position: RowFile
    on_wall: RowFile
    part: WallPart
    nearest: float
    farthest: float


class SurfaceCaster:
    """Casts the rays of projectors at a mesh. Raises InputError if Open3D cannot be loaded."""

    def __init__(self, mesh: Mesh, viewpoint: WallView) -> None:
        self._mesh, self._viewpoint = mesh, viewpoint
        self._tensor = open3d().core.Tensor
        self._scene = open3d().t.geometry.RaycastingScene()
        self._scene.add_triangles(mesh.points.astype(np.float32), mesh.triangles.astype(np.uint32))

    def view(
        self, projector: StoredDevice, to_file: Floats, depth: RowFile, position: RowFile, on_wall: RowFile
    ) -> ProjectorView:
        """Fill the files of a view. `to_file` (3,): factors from the mesh's axes to those of the files."""
        scale = float(abs(to_file[0]))
        surface = _Surface(projector, self._mesh, self._viewpoint)
        for rows in row_bands(depth.shape):
            rays = surface.rays(rows)
            lit = surface.lit(rays, self._scene.cast_rays(self._tensor(rays)))
            depth.append(np.float32(scale) * np.nan_to_num(lit.depth))
            position.append(to_file.astype(np.float32) * np.nan_to_num(lit.points))
            on_wall.append(lit.on_wall)
        nearest, farthest = surface.reach
        return ProjectorView(projector, depth, position, on_wall, surface.part(), scale * nearest, scale * farthest)


@dataclass(frozen=True, eq=False)
class _Lit:
    """Of rows (n, W): points (n, W, 3) and depth (n, W) in the scene's frame, NaN where nothing is lit; `on_wall`
    (n, W, 2).
    """

    points: Numbers
    depth: Numbers
    on_wall: Numbers


class _Surface:
    """The surface as one projector lights it, and what is known about all of its rows so far."""

    def __init__(self, projector: StoredDevice, mesh: Mesh, viewpoint: WallView) -> None:
        self._projector, self._mesh, self._viewpoint = projector, mesh, viewpoint
        self._low, self._high = np.full(2, np.inf), np.full(2, -np.inf)
        self._sides = list[Numbers]()
        self.reach = (np.inf, 0.0)

    def rays(self, rows: slice) -> Numbers:
        """Origins and directions (n, W, 6) of the pixels of some rows; their length along the axis is one."""
        lens, place = self._projector.intrinsics, self._projector.place
        rays = np.empty((rows.stop - rows.start, lens.width, 6), np.float32)
        rays[..., :3] = place.translation

        def fill(part: slice) -> None:
            x, y = np.meshgrid(np.arange(float(lens.width)), np.arange(rows.start, rows.stop, 1.0)[part])
            rays[part, :, 3:] = place.rotate(lens.unproject(np.stack([x, y], axis=-1)))

        in_slices(len(rays), _slice_rows(lens.width), fill)
        return rays

    def lit(self, rays: Numbers, hits: Any) -> _Lit:
        """Where the rays (n, W, 6) of some rows meet the surface."""
        wall, eye, mesh = self._viewpoint.wall, self._viewpoint.eye, self._mesh
        depth, ids, shares = (hits[name].numpy() for name in ("t_hit", "primitive_ids", "primitive_uvs"))
        points, on_wall = np.empty((*depth.shape, 3), np.float32), np.empty((*depth.shape, 2), np.float32)
        from_eye = np.zeros(3) if eye is None else eye

        def fill(part: slice) -> Floats:
            reach = np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
            _light(
                rays[part].reshape(-1, 6),
                depth[part].reshape(-1),
                ids[part].reshape(-1),
                shares[part].reshape(-1, 2),
                mesh.triangles,
                mesh.normals,
                wall.normal,
                wall.offset,
                wall.within,
                wall.axes,
                from_eye,
                eye is not None,
                _GRAZING,
                points[part].reshape(-1, 3),
                on_wall[part].reshape(-1, 2),
                reach,
            )
            return reach

        for low, high in in_slices(len(depth), _slice_rows(depth.shape[1]), fill):
            self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
        self._sides.append(self._pixel_sides(points))
        there = depth[np.isfinite(depth)]
        if there.size:
            self.reach = min(self.reach[0], float(there.min())), max(self.reach[1], float(there.max()))
        return _Lit(points, depth, on_wall)

    def part(self) -> WallPart:
        """What was lit of the wall."""
        sides = np.concatenate(self._sides)
        known = sides[np.isfinite(sides)]
        return WallPart(self._low, self._high, float(np.median(known)) if known.size else np.nan)

    def _pixel_sides(self, points: Numbers) -> Numbers:
        """The sides (m,) of pixels on the wall: of every `step`-th, from its neighbours' points in rows (n, W, 3)."""
        wall, size = self._viewpoint.wall, self._projector.intrinsics.size
        step = max(1, round((size.width * size.height / _SIZED_PIXELS) ** 0.5))
        inner = slice(1, -1, step)
        across = (points[inner, 2::step] - points[inner, :-2:step]) @ (wall.axes / 2)
        down = (points[2::step, inner] - points[:-2:step, inner]) @ (wall.axes / 2)
        area = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
        is_wall = np.abs(points[inner, inner] @ wall.normal - wall.offset) < wall.within
        return np.sqrt(area[is_wall]).astype(np.float32)


def _slice_rows(width: int) -> int:
    return max(1, _SLICE_PIXELS // width)


@compiled
def _light(
    rays: Numbers,
    depth: Numbers,
    ids: NDArray[np.uint32],
    shares: Numbers,
    triangles: Ints,
    normals: Floats,
    wall_normal: Floats,
    wall_offset: float,
    within: float,
    axes: Floats,
    eye: Floats,
    has_eye: bool,
    grazing: float,
    points: Numbers,
    on_wall: Numbers,
    reach: Floats,
) -> None:
    """Points on rays (N, 6), and where they are seen on the wall, from the triangle and the barycentric coordinates of
    each hit; `reach` (2, 2): the smallest and largest coordinates of the points of the wall.
    """
    towards, seen = np.empty(3), np.empty(3)
    eye_ahead = eye[0] * wall_normal[0] + eye[1] * wall_normal[1] + eye[2] * wall_normal[2] - wall_offset
    for i in range(len(depth)):
        on_wall[i, 0] = on_wall[i, 1] = np.nan
        if not np.isfinite(depth[i]):
            depth[i] = np.nan
            points[i, 0] = points[i, 1] = points[i, 2] = np.nan
            continue
        ahead, length, off = 0.0, 0.0, -wall_offset
        for k in range(3):
            points[i, k] = rays[i, k] + depth[i] * rays[i, 3 + k]
            off += points[i, k] * wall_normal[k]
            towards[k] = eye[k] - points[i, k] if has_eye else wall_normal[k]
            ahead += towards[k] * wall_normal[k]
            length += towards[k] * towards[k]
        if abs(off) < within:
            for axis in range(2):
                at = points[i, 0] * axes[0, axis] + points[i, 1] * axes[1, axis] + points[i, 2] * axes[2, axis]
                reach[0, axis], reach[1, axis] = min(reach[0, axis], at), max(reach[1, axis], at)
        if not ahead > 0.0:
            continue
        share = eye_ahead / ahead
        first, second, third = triangles[ids[i], 0], triangles[ids[i], 1], triangles[ids[i], 2]
        facing = 0.0
        for k in range(3):
            normal = (
                (1.0 - shares[i, 0] - shares[i, 1]) * normals[first, k]
                + shares[i, 0] * normals[second, k]
                + shares[i, 1] * normals[third, k]
            )
            facing += normal * towards[k]
            seen[k] = eye[k] - share * towards[k] if has_eye else points[i, k]
        if facing > grazing * np.sqrt(length):
            for axis in range(2):
                on_wall[i, axis] = seen[0] * axes[0, axis] + seen[1] * axes[1, axis] + seen[2] * axes[2, axis]
