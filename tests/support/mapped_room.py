"""The result folder of a network in a simulated room with two projectors side by side, a wall and a box; and what the
wall shows.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from calib.numerics import Floats
from hw.simulated import Block, Optics, PictureOptics, PlacedDevice, ProjectorLight, Scene, look_at
from scanner.io import CloudPoints, write_room, write_room_ply

STEP_PX = 4  # of a projector's image, from point to point of the cloud
GAMMA, CONTRAST = 2.2, 1e9
_UP = np.array([0.0, 0.0, 1.0])
# The largest wall is at y = 0; a box stands before it.
SCENE = Scene(
    Block(np.zeros(3), np.diag([4.0, 3.0, 2.5])), (Block(np.array([1.95, 0.0, 0.0]), np.diag([0.3, 0.25, 1.35])),)
)
PROJECTORS = {
    "left": PlacedDevice(
        Optics(320, 200, 330.0, (158.0, 168.0), -0.06, 0.01),
        look_at(np.array([1.4, 2.4, 1.1]), np.array([1.5, 0.0, 1.15]), _UP, 1.0),
        np.array([1.4, 2.4, 1.1]),
    ),
    "right": PlacedDevice(
        Optics(400, 250, 400.0, (203.0, 205.0), 0.04, 0.0),
        look_at(np.array([2.7, 2.5, 1.3]), np.array([2.4, 0.0, 1.1]), _UP, -2.0),
        np.array([2.7, 2.5, 1.3]),
    ),
}
# The network's frame: that of a camera between them.
CAMERA = PlacedDevice(
    Optics(640, 480, 600.0, (320.0, 240.0)),
    look_at(np.array([2.0, 2.6, 1.2]), np.array([2.1, 0.0, 1.0]), _UP, 0.0),
    np.array([2.0, 2.6, 1.2]),
)


@dataclass(frozen=True)
class _Cloud(CloudPoints):
    unit: str = "m"


def to_network(points: Floats) -> Floats:
    """Points (..., 3) of the room → the network's frame."""
    moved: Floats = (points - CAMERA.centre) @ CAMERA.rotation.T
    return moved


def write_network(folder: Path, rng: np.random.Generator, noise_m: float = 3e-4) -> Path:
    """Write network.yaml with the true devices, and network.ply with noise along the rays."""
    folder.mkdir(parents=True)
    devices = [_entry("camera", "camera", CAMERA)]
    points, normals = [], []
    for name, projector in PROJECTORS.items():
        devices.append(_entry(name, "projector", projector))
        x, y = np.meshgrid(
            *(np.arange(1.5, side, STEP_PX) for side in (projector.optics.width, projector.optics.height))
        )
        rays = projector.rays(np.stack([x.ravel(), y.ravel()]))
        t, surface = SCENE.cast(projector.centre[:, None], rays)
        met = projector.centre[:, None] + (t + noise_m * rng.standard_normal(len(t))) * rays
        points.append(to_network(met.T))
        normals.append(SCENE.normals(surface, met).T @ CAMERA.rotation.T)
    cloud = np.concatenate(points)
    write_room(folder / "network.yaml", {"unit": "m", "devices": devices})
    colours = np.full((len(cloud), 3), 128, np.uint8)
    write_room_ply(folder / "network.ply", _Cloud(cloud, np.concatenate(normals), colours, None))
    return folder


def write_projectors(folder: Path, count: int, size: tuple[int, int]) -> None:
    """Write the network with `count` projectors of a size, in turn like each of the two, every second further right."""
    write_network(folder, np.random.default_rng(0))
    path = folder / "network.yaml"
    network = yaml.safe_load(path.read_text(encoding="utf-8"))
    camera, *originals = network["devices"]
    devices = [camera]
    for number in range(count):
        device = dict(originals[number % 2])
        factor = size[0] / device["width"]
        focal, centre = ([factor * value for value in device[key]] for key in ("focal_px", "principal_point_px"))
        x, y, z = device["translation"]
        moved = [x + 0.1 * (number // 2), y, z]
        device |= {"name": f"projector-{number}", "width": size[0], "height": size[1], "translation": moved}
        devices.append(device | {"focal_px": focal, "principal_point_px": centre})
    path.write_text(yaml.safe_dump({**network, "devices": devices}), encoding="utf-8")


def shown_on_wall(pictures: dict[str, NDArray[np.uint8]], points: Floats) -> Floats:
    """Linear light (n,) at points (n, 3) of the room's wall while projectors show 8-bit pictures (H, W)."""
    total = np.zeros(len(points))
    for name, picture in pictures.items():
        projector = PROJECTORS[name]
        optics = PictureOptics(projector.optics.width, projector.optics.height, GAMMA, CONTRAST, 0.3)
        pixels, irradiance = ProjectorLight(SCENE, projector).direct(np.full(len(points), 1, np.int32), points.T)
        lit = np.flatnonzero((irradiance > 0) & projector.optics.sees(pixels))
        texels, weight = optics.interpolate(pixels[:, lit])
        total[lit] += np.sum(optics.blurred(optics.linear(picture))[texels] * weight, axis=1)
    return total


def _entry(name: str, kind: str, device: PlacedDevice) -> dict[str, object]:
    """Entry of network.yaml: X_network = rotation X_device + translation."""
    optics = device.optics
    return {
        "name": name,
        "kind": kind,
        "width": optics.width,
        "height": optics.height,
        "focal_px": [optics.focal_px] * 2,
        "principal_point_px": list(optics.principal_point_px),
        "distortion": [optics.k1, optics.k2, 0.0, 0.0, 0.0],
        "rotation": (CAMERA.rotation @ device.rotation.T).tolist(),
        "translation": to_network(device.centre).tolist(),
    }
