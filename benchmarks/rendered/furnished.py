"""A furnished room for Mitsuba, with two balls, and stations in it."""

import mitsuba as mi
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from rendered.devices import Array, Place

BALLS_M, RADIUS_M = 3.0, 0.12


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
