"""What a projector lights, pixel by pixel, seen from its own eye through its own lens."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints, compiled
from scanner.exporting.mapping.rasterisation import TriangleRaster
from scanner.exporting.mapping.scene import WallView
from scanner.exporting.triangles import Mesh
from scanner.io import RowFile, StoredDevice, in_rows

Numbers = NDArray[np.float32]

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


def view_surface(
    projector: StoredDevice,
    mesh: Mesh,
    viewpoint: WallView,
    to_file: Floats,
    depth: RowFile,
    position: RowFile,
    on_wall: RowFile,
) -> ProjectorView:
    """Fill the files of a view. `to_file` (3,): factors from the mesh's axes to those of the files."""
    scale = float(abs(to_file[0]))
    surface = _Surface(projector, mesh, viewpoint)

    def fill(rows: slice) -> _LitPart:
        lit = surface.lit(rows)
        on_wall.write(rows, lit.on_wall)
        part = surface.part(lit)
        _scale(lit.depth.reshape(-1, 1), np.array([scale], np.float32))
        _scale(lit.points.reshape(-1, 3), to_file.astype(np.float32))
        depth.write(rows, lit.depth)
        position.write(rows, lit.points)
        return part

    parts = in_rows(depth.shape, fill)
    sides = np.concatenate([part.sides for part in parts])
    known = sides[np.isfinite(sides)]
    wall = WallPart(
        np.min([part.low for part in parts], axis=0),
        np.max([part.high for part in parts], axis=0),
        float(np.median(known)) if known.size else np.nan,
    )
    nearest, farthest = min(part.nearest for part in parts), max(part.farthest for part in parts)
    return ProjectorView(projector, depth, position, on_wall, wall, scale * nearest, scale * farthest)


@dataclass(frozen=True, eq=False)
class _Lit:
    """What some rows of pixels light, in the scene's frame."""

    # (n, W, 3), NaN where nothing is lit.
    points: Numbers
    # (n, W), NaN where nothing is lit.
    depth: Numbers
    # (n, W, 2), as in `ProjectorView`.
    on_wall: Numbers
    # (2, 2): the smallest and the largest coordinates of points of the wall.
    reach: Floats


@dataclass(frozen=True, eq=False)
class _LitPart:
    """What some rows say of the wall and the depth; fields as in `WallPart` and `ProjectorView`."""

    low: Floats
    high: Floats
    # (m,): of some pixels; NaN where a neighbour lights nothing.
    sides: Numbers
    nearest: float
    farthest: float


class _Surface:
    """The surface as one projector lights it."""

    def __init__(self, projector: StoredDevice, mesh: Mesh, viewpoint: WallView) -> None:
        self._lens, self._place, self._mesh, self._viewpoint = projector.intrinsics, projector.place, mesh, viewpoint
        self._raster = TriangleRaster(projector.place.inverse() @ mesh.points, mesh.triangles)

    def lit(self, rows: slice) -> _Lit:
        """Where the rays of the pixels of some rows meet the surface."""
        x, y = np.meshgrid(np.arange(float(self._lens.width)), np.arange(rows.start, rows.stop, 1.0))
        rays = self._lens.ideal(np.stack([x, y], axis=-1))
        hits = self._raster.hits(rays)
        points, on_wall = np.empty((*x.shape, 3), np.float32), np.empty((*x.shape, 2), np.float32)
        reach = np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
        wall, eye = self._viewpoint.wall, self._viewpoint.eye
        _light(
            rays.reshape(-1, 2),
            hits.depth.reshape(-1),
            hits.triangle.reshape(-1),
            self._raster.points,
            self._mesh.triangles,
            self._mesh.normals,
            self._place.rotation,
            self._place.translation,
            wall.normal,
            wall.offset,
            wall.within,
            wall.axes,
            np.zeros(3) if eye is None else eye,
            eye is not None,
            _GRAZING,
            points.reshape(-1, 3),
            on_wall.reshape(-1, 2),
            reach,
        )
        return _Lit(points, hits.depth, on_wall, reach)

    def part(self, lit: _Lit) -> _LitPart:
        """What the rows say of the wall and the depth."""
        depth = lit.depth[np.isfinite(lit.depth)]
        nearest, farthest = (float(depth.min()), float(depth.max())) if depth.size else (np.inf, 0.0)
        return _LitPart(lit.reach[0], lit.reach[1], self._pixel_sides(lit.points), nearest, farthest)

    def _pixel_sides(self, points: Numbers) -> Numbers:
        """The sides (m,) of pixels on the wall: of every `step`-th, from its neighbours' points in rows (n, W, 3)."""
        wall, size = self._viewpoint.wall, self._lens.size
        step = max(1, round((size.width * size.height / _SIZED_PIXELS) ** 0.5))
        inner = slice(1, -1, step)
        across = (points[inner, 2::step] - points[inner, :-2:step]) @ (wall.axes / 2)
        down = (points[2::step, inner] - points[:-2:step, inner]) @ (wall.axes / 2)
        area = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
        is_wall = np.abs(points[inner, inner] @ wall.normal - wall.offset) < wall.within
        return np.sqrt(area[is_wall]).astype(np.float32)


@compiled
def _light(
    rays: Floats,
    depth: Numbers,
    hits: NDArray[np.int32],
    corners: Floats,
    triangles: Ints,
    normals: Floats,
    rotation: Floats,
    centre: Floats,
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
    """Points on rays (N, 2) of the projector at `centre`, and where they are seen on the wall, from the triangle that
    each hits; its `corners` are in the projector's frame. `reach` (2, 2): as in `_Lit`.
    """
    towards, seen_from_eye, shares = np.empty(3), np.empty(3), np.empty(3)
    eye_ahead = eye[0] * wall_normal[0] + eye[1] * wall_normal[1] + eye[2] * wall_normal[2] - wall_offset
    for i in range(len(depth)):
        on_wall[i, 0] = on_wall[i, 1] = np.nan
        if not np.isfinite(depth[i]):
            depth[i] = np.nan
            points[i, 0] = points[i, 1] = points[i, 2] = np.nan
            continue
        x, y = rays[i, 0], rays[i, 1]
        ahead, length, off = 0.0, 0.0, -wall_offset
        for k in range(3):
            points[i, k] = depth[i] * (rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]) + centre[k]
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
        share, total = eye_ahead / ahead, 0.0
        for corner in range(3):
            p = corners[triangles[hits[i], (corner + 1) % 3]]
            q = corners[triangles[hits[i], (corner + 2) % 3]]
            shares[corner] = (
                x * (p[1] * q[2] - p[2] * q[1]) + y * (p[2] * q[0] - p[0] * q[2]) + p[0] * q[1] - p[1] * q[0]
            )
            total += shares[corner]
        facing = 0.0
        for k in range(3):
            normal = 0.0
            for corner in range(3):
                normal += shares[corner] * normals[triangles[hits[i], corner], k]
            facing += normal / total * towards[k]
            seen_from_eye[k] = eye[k] - share * towards[k] if has_eye else points[i, k]
        if facing > grazing * np.sqrt(length):
            for axis in range(2):
                on_wall[i, axis] = (
                    seen_from_eye[0] * axes[0, axis]
                    + seen_from_eye[1] * axes[1, axis]
                    + seen_from_eye[2] * axes[2, axis]
                )


@compiled
def _scale(values: Numbers, factors: Numbers) -> None:
    """Multiply each of the columns (N, C) with its factor, in place; 0 where NaN was."""
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            values[i, k] = 0.0 if np.isnan(values[i, k]) else factors[k] * values[i, k]
