"""What a projector lights, pixel by pixel, seen from its own eye through its own lens."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.numerics import Bools, Floats
from scanner.exporting.mapping.scene import Scene
from scanner.exporting.open3d_module import open3d
from scanner.io import StoredDevice


@dataclass(frozen=True, eq=False)
class ProjectorView:
    """Of each pixel of `projector`, (H, W, …): the point that it lights, the normal there, the depth along the
    projector's axis; NaN where it lights nothing that was measured.
    """

    projector: StoredDevice
    points: Floats
    normals: Floats
    depth: Floats

    @property
    def there(self) -> Bools:
        """Whether a pixel lights anything, (H, W)."""
        return np.isfinite(self.depth)


def projector_views(scene: Scene) -> list[ProjectorView]:
    """Cast each pixel's ray at the mesh."""
    o3d = open3d()
    caster = o3d.t.geometry.RaycastingScene()
    mesh = scene.mesh
    caster.add_triangles(mesh.points.astype(np.float32), mesh.triangles.astype(np.uint32))
    found = []
    for projector in scene.projectors:
        place = projector.place
        rays = rays_of(projector)
        origins = np.broadcast_to(place.translation, rays.shape)
        hits = caster.cast_rays(o3d.core.Tensor(np.concatenate([origins, rays], axis=-1).astype(np.float32)))
        depth = hits["t_hit"].numpy().astype(np.float64)
        depth[~np.isfinite(depth)] = np.nan  # directions have unit depth
        points = place.translation + depth[..., None] * rays
        found.append(ProjectorView(projector, points, _normals(scene, hits, np.isfinite(depth)), depth))
    return found


def rays_of(projector: StoredDevice) -> Floats:
    """Directions (H, W, 3) of a projector's pixels in the scene's frame, their length along its axis is one."""
    return projector.intrinsics.unproject(projector.intrinsics.size.pixels) @ projector.place.rotation.T


def _normals(scene: Scene, hits: Any, there: Bools) -> Floats:
    """Interpolated between the corners of the triangle that was hit."""
    normals = np.full((*there.shape, 3), np.nan)
    corners = scene.mesh.normals[scene.mesh.triangles[hits["primitive_ids"].numpy()[there].astype(np.int64)]]
    second, third = hits["primitive_uvs"].numpy()[there].T
    share = np.stack([1 - second - third, second, third], axis=1)
    normals[there] = np.einsum("nk,nkj->nj", share, corners)
    return normals
