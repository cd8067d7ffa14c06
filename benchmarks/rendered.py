"""Rooms rendered with Mitsuba 3: it has scene, textures and intersections; light is traced here.

The room is furnished and holds two balls; stations in it have a camera and a projector with lenses, fixed to each
other. The light of a projector is direct, and that after one or two bounces, for all pictures at once.
"""

from dataclasses import dataclass

import cv2
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

mi.set_variant("llvm_ad_mono")  # before any of its classes is named

Array = NDArray[np.float64]
_CAMERA, _PROJECTOR = (640, 512), (854, 480)
BALLS_M, RADIUS_M = 3.0, 0.12
_GRID = 4  # camera pixels per pixel of the bounced light
_CHUNK = 4_000_000
_EPSILON = 1e-4
_SIDE = 3  # sub-pixels per camera pixel, along each side


@dataclass(frozen=True)
class Device:
    """A pinhole with distortion: width, height; f, x_0, y_0; k1, k2, p1, p2, k3 in OpenCV's order."""

    size: tuple[int, int]
    focal: float
    centre: tuple[float, float]
    lens: tuple[float, float, float, float, float]

    def project(self, points: Array) -> Array:
        zero = np.zeros(3)
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), zero, zero, self.matrix, np.array(self.lens))
        return pixels.reshape(-1, 2).astype(np.float64)

    def rays(self, pixels: Array) -> Array:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        ideal = cv2.undistortPoints(
            pixels.reshape(-1, 1, 2), self.matrix, np.array(self.lens), None, None, None, criteria
        )
        return np.concatenate([ideal.reshape(-1, 2), np.ones((len(pixels), 1))], axis=1)

    @property
    def matrix(self) -> Array:
        return np.array([[self.focal, 0, self.centre[0]], [0, self.focal, self.centre[1]], [0, 0, 1.0]])


@dataclass(frozen=True)
class Rig:
    """X_projector = rotation X_camera + translation, in metres."""

    camera: Device
    projector: Device
    rotation: Array
    translation: Array


@dataclass(frozen=True)
class Place:
    """X_world = rotation X_camera + translation."""

    rotation: Array
    translation: Array


def draw_rig(rng: np.random.Generator, tangential: float) -> Rig:
    def lens(k1: float, k2: float) -> tuple[float, float, float, float, float]:
        p1, p2 = rng.normal(0, tangential, 2)
        return k1, k2, p1, p2, 0.0

    camera = Device(_CAMERA, 478.0, (319.5 + rng.normal(0, 7), 255.5 + rng.normal(0, 7)), lens(-0.07, 0.012))
    projector = Device(_PROJECTOR, 690.0, (428.0 + rng.normal(0, 4), 372.0 + rng.normal(0, 8)), lens(-0.02, 0.0))
    turn = Rotation.from_euler("yxz", [-rng.uniform(6, 9), -rng.uniform(8, 12), rng.normal(0, 1.5)], degrees=True)
    centre = np.array([0.34, rng.uniform(-0.02, 0.1), rng.uniform(-0.03, 0.06)])
    rotation = turn.as_matrix().T
    return Rig(camera, projector, rotation, -rotation @ centre)


def world_rays(rig: Rig, place: Place, pixels: Array) -> tuple[Array, Array]:
    directions = rig.camera.rays(pixels.reshape(-1, 2)) @ place.rotation.T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.broadcast_to(place.translation, directions.shape), directions


def room(rng: np.random.Generator, size: Array) -> tuple[dict[str, object], list[tuple[Array, Array, float]], Array]:
    """A furnished room for `mi.load_dict`; its boxes (centre, half size, yaw); and the centres of both balls."""
    scene: dict[str, object] = {"type": "scene"}
    for wall in range(6):
        axis, side = wall % 3, wall // 3
        inward = np.eye(3)[axis] * (1 - 2 * side) + np.radians(0.3) * rng.normal(size=3)
        at = size / 2
        at[axis] = side * size[axis]
        scene[f"wall{wall}"] = _rectangle(inward / np.linalg.norm(inward), at, 6.0, _texture(rng, 0.72, 0.05))
    boxes = []
    for piece in range(9):
        half = np.array([rng.uniform(0.25, 0.75), rng.uniform(0.15, 0.32), rng.uniform(0.2, 0.95)])
        wall, yaw = piece % 4, np.pi / 2 * (piece % 4) + np.radians(rng.normal(0, 4))
        across, along = (size[1], size[0]) if wall % 2 == 0 else (size[0], size[1])
        out = across / 2 - half[1] - rng.uniform(0.05, 0.2)
        aside = rng.uniform(-0.5, 0.5) * (along - 2 * half[0])
        turned = Rotation.from_euler("z", np.pi / 2 * wall).as_matrix() @ np.array([aside, -out, 0.0])
        high = rng.uniform(1.4, 1.7) if piece >= 7 else half[2]  # a shelf on the wall
        half[2] = 0.2 if piece >= 7 else half[2]
        centre = turned + np.array([size[0] / 2, size[1] / 2, high])
        boxes.append((centre, half, yaw))
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_euler("z", yaw).as_matrix() * half
        matrix[:3, 3] = centre
        bsdf = _texture(rng, rng.uniform(0.45, 0.75), 0.1)
        scene[f"box{piece}"] = {"type": "cube", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf}
    middle, turn = size / 2, rng.uniform(0, 2 * np.pi)
    apart = BALLS_M / 2 * np.array([np.cos(turn), np.sin(turn), rng.uniform(-0.15, 0.15)])
    apart *= BALLS_M / 2 / np.linalg.norm(apart)
    apart = min((apart, apart * [-1, 1, 1]), key=lambda bar: float(np.max(np.abs(bar[:2]) / size[:2])))
    balls = np.stack([middle - apart, middle + apart])
    balls[:, 2] += 0.45 - middle[2]
    for k, centre in enumerate(balls):
        scene[f"ball{k}"] = {
            "type": "sphere",
            "center": centre.tolist(),
            "radius": RADIUS_M,
            "bsdf": _texture(rng, 0.7, 0.0),
        }
    return scene, boxes, balls


def _texture(rng: np.random.Generator, albedo: float, spread: float) -> dict[str, object]:
    scales = 2.0, 6.0, 20.0
    waves = np.sum([gaussian_filter(rng.normal(size=(256, 256)), s, mode="wrap") * s for s in scales], axis=0)
    values = np.clip(albedo * (1 + spread * waves / max(float(waves.std()), 1e-9)), 0.1, 0.9).astype(np.float32)
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(values[..., None]), "raw": True}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": bitmap}}


def _rectangle(normal: Array, at: Array, half: float, bsdf: dict[str, object]) -> dict[str, object]:
    aside = np.cross(normal, [0.3, 0.5, 0.8])
    aside /= np.linalg.norm(aside)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([half * aside, half * np.cross(normal, aside), normal], axis=1)
    matrix[:3, 3] = at
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf}


def ring(rng: np.random.Generator, size: Array, boxes: list[tuple[Array, Array, float]], count: int) -> list[Place]:
    """Stations that look across the room, at steps of a sixth of a turn."""
    first, places = rng.uniform(0, 2 * np.pi), []
    for k in range(count):
        for _ in range(500):
            yaw = first + 2 * np.pi * (k + rng.uniform(-0.06, 0.06)) / count
            ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
            eye = size / 2 * [1, 1, 0] - rng.uniform(0.5, 0.8) * size[:2].min() / 2 * ahead
            eye += [*rng.uniform(-0.15, 0.15, 2), rng.uniform(1.2, 1.6)]
            if not any(_inside(box, eye, 0.4) for box in boxes):
                break
        forward = ahead - [0, 0, rng.uniform(0.22, 0.42)]
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        upright = np.stack([right, np.cross(forward, right), forward], axis=1)
        places.append(Place(upright @ Rotation.from_euler("z", rng.normal(0, 0.03)).as_matrix(), eye))
    return places


def _inside(box: tuple[Array, Array, float], point: Array, margin: float) -> bool:
    centre, half, yaw = box
    own = (point - centre) @ Rotation.from_euler("z", yaw).as_matrix()
    return bool(np.all(np.abs(own[:2]) < half[:2] + margin) and own[2] < half[2] + margin)


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
