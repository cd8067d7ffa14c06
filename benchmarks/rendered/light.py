"""The light of a projector in a scene of Mitsuba: direct, and after one or two bounces, for all pictures at once."""

from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from rendered.devices import Array, Place, Rig, world_rays

_GRID = 4  # camera pixels per pixel of the bounced light
_CHUNK = 4_000_000
_EPSILON = 1e-4
_SIDE = 3  # sub-pixels per camera pixel, along each side


@dataclass(frozen=True)
class Hits:
    """Hits of rays (N): points and normals (N, 3) facing the ray; albedo (N,); found (N,)."""

    points: Array
    normals: Array
    albedo: Array
    found: NDArray[np.bool_]


def trace(scene: "mi.Scene", origins: Array, directions: Array) -> Hits:
    """Trace rays (N, 3) into the scene."""
    parts = []
    for start in range(0, len(origins), _CHUNK):
        o, d = origins[start : start + _CHUNK], directions[start : start + _CHUNK]
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(d.T)))
        hit = si.is_valid()
        albedo = np.array(si.bsdf().eval_diffuse_reflectance(si, hit), np.float64).reshape(-1)
        normal = np.array(si.n, np.float64).T
        normal *= -np.sign(np.sum(normal * d, axis=1, keepdims=True))
        parts.append((np.array(si.p, np.float64).T, normal, albedo, np.array(hit)))
    points, normals, albedo, found = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Hits(points, normals, albedo, found.astype(np.bool_))


def lit(scene: "mi.Scene", hits: Hits, rig: Rig, place: Place) -> tuple[Array, Array]:
    """Projector pixels (N, 2) of hits, and the irradiance of white there, (N,), without albedo."""
    in_camera = (hits.points - place.translation) @ place.rotation
    seen = in_camera @ rig.rotation.T + rig.translation
    ahead = hits.found & (seen[:, 2] > 0.05)
    pixels = np.full((len(seen), 2), np.nan)
    pixels[ahead] = rig.projector.project(seen[ahead])
    width, height = rig.projector.size
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels > -0.5) & (pixels < [width - 0.5, height - 0.5]), axis=1)
        # Exclude points that the lens model folds back into the picture.
        inside &= np.hypot(seen[:, 0], seen[:, 1]) < 1.5 * seen[:, 2]
    eye = place.translation + place.rotation @ (-rig.rotation.T @ rig.translation)
    bright, chosen = np.zeros(len(seen)), np.flatnonzero(inside)
    to_eye = eye - hits.points[chosen]
    distance = np.linalg.norm(to_eye, axis=1)
    cosine = np.sum(to_eye * hits.normals[chosen], axis=1) / distance
    at = hits.points[chosen] + _EPSILON * hits.normals[chosen]
    free = np.zeros(len(chosen), np.bool_)
    for start in range(0, len(chosen), _CHUNK):
        part = slice(start, start + _CHUNK)
        ray = mi.Ray3f(mi.Point3f(at[part].T), mi.Vector3f((to_eye / distance[:, None])[part].T))
        ray.maxt = mi.Float(((1 - 1e-3) * distance[part]).astype(np.float32))
        free[part] = ~np.array(scene.ray_test(ray))
    # A uniform picture on a screen: intensity increases with 1 / cos³ of the angle to the axis.
    off_axis = seen[chosen, 2] / distance
    bright[chosen] = np.where(free & (cosine > 0), cosine / distance**2 / off_axis**3, 0.0)
    return pixels, bright


def direct_light(scene: "mi.Scene", rig: Rig, place: Place, rng: np.random.Generator) -> tuple[Array, Array]:
    """Sub-pixels: pixels of the picture (H, W, 9, 2) and brightness (H, W, 9).

    They are random within their ninths, as in renderers: this shifts a pixel by 0.05 of the picture's pixels.
    """
    width, height = rig.camera.size
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    cells = (np.stack(np.meshgrid(np.arange(_SIDE), np.arange(_SIDE)), axis=-1).reshape(-1, 2) + 0.5) / _SIDE - 0.5
    pixels = np.stack([x, y], axis=-1)[:, :, None] + cells
    pixels += rng.uniform(-0.5, 0.5, pixels.shape) / _SIDE
    hits = trace(scene, *world_rays(rig, place, pixels.reshape(-1, 2)))
    at, bright = lit(scene, hits, rig, place)
    return at.reshape(height, width, -1, 2), (hits.albedo * bright).reshape(height, width, -1) / np.pi


def bounced_light(
    scene: "mi.Scene", rig: Rig, place: Place, rng: np.random.Generator, paths: int
) -> tuple[list[Array], Hits]:
    """Light after one and two bounces at a coarser grid of camera pixels (n), by columns (n, width) and by rows (n,
    height) of the picture.

    It excludes the own albedo of the pixels. Also returns where they are.
    """
    width, height = rig.camera.size
    x, y = np.meshgrid(np.arange(0, width, _GRID), np.arange(0, height, _GRID))
    seen = trace(scene, *world_rays(rig, place, np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64)))
    count, bins = x.size, rig.projector.size
    sums = [np.zeros(count * size) for size in bins]
    per_round = max(1, _CHUNK // count)
    for first in range(0, paths, per_round):
        many = min(per_round, paths - first)
        pixel = np.repeat(np.arange(count), many)
        at = Hits(seen.points[pixel], seen.normals[pixel], seen.albedo[pixel], seen.found[pixel])
        weight = np.full(len(pixel), 1 / paths)
        for _ in range(2):
            # Estimator of irradiance over π: radiance along cosine-weighted directions.
            at = trace(scene, at.points + _EPSILON * at.normals, _cosine_weighted(at.normals, rng))
            weight = weight * at.albedo
            where, bright = lit(scene, at, rig, place)
            used = np.flatnonzero(bright > 0)
            for axis, size in enumerate(bins):
                bin_of = np.clip(np.rint(where[used, axis]), 0, size - 1).astype(np.int64)
                amount = weight[used] * bright[used] / np.pi
                sums[axis] += np.bincount(pixel[used] * size + bin_of, amount, count * size)
    return [each.reshape(count, size) for each, size in zip(sums, bins, strict=True)], seen


def _cosine_weighted(normals: Array, rng: np.random.Generator) -> Array:
    directions = rng.normal(size=normals.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions += (1 + 1e-6) * normals
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions


def spread(coarse: Hits, fine: Hits, size: tuple[int, int]) -> csr_array:
    """From the coarse pixels (n) to the camera's (H W): means over neighbours on the same surface."""
    width, height = size
    across, down = -(-width // _GRID), -(-height // _GRID)
    x, y = (each.reshape(-1) for each in np.meshgrid(np.arange(width) / _GRID, np.arange(height) / _GRID))
    indices, weights = [], []
    for dy in range(-1, 3):
        for dx in range(-1, 3):
            i, j = np.floor(x).astype(np.int64) + dx, np.floor(y).astype(np.int64) + dy
            inside = (i >= 0) & (i < across) & (j >= 0) & (j < down)
            index = np.where(inside, j * across + i, 0)
            alike = np.sum(fine.normals * coarse.normals[index], axis=1) > 0.99
            off = np.abs(np.sum((coarse.points[index] - fine.points) * fine.normals, axis=1))
            near = np.exp(-((x - i) ** 2 + (y - j) ** 2) / 2)
            indices.append(index)
            weights.append(np.where(inside & alike & (off < 0.01), near, 1e-9 * near * inside))
    weight = np.stack(weights, axis=1)
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.arange(0, weight.size + 1, weight.shape[1])
    return csr_array((weight.ravel(), np.stack(indices, axis=1).ravel(), rows), (len(weight), len(coarse.albedo)))
