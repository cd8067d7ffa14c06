"""Capture folders of a synthetic network: every camera's frames in every projector's light."""

from pathlib import Path

import numpy as np
import yaml

from calib.numerics import Bools, Floats
from calib.synthetic import SyntheticNetwork, cast
from scanner.io import write_png
from scanner.patterns import pattern_to_dict, sequence_for

_DARK, _GREY, _NEAR_M = 12.0, 190.0, 1e-6


def write_captures(folder: Path, network: SyntheticNetwork, rng: np.random.Generator) -> list[Path]:
    """Folders `<camera>-<projector>`, with noise of one grey level."""
    return [_write(folder / f"{c}-{p}", network, c, p, rng) for c, p in network.captures]


def _write(folder: Path, network: SyntheticNetwork, camera: str, projector: str, rng: np.random.Generator) -> Path:
    projector_px, lit = _seen(network, camera, projector)
    sizes = {"camera": network.devices[camera].size, "projector": network.devices[projector].size}
    (folder / "frames").mkdir(parents=True)
    frames = []
    for index, pattern in enumerate(sequence_for(sizes["projector"], cell=8, periods=(16.0,), shifts=4)):
        light = np.broadcast_to(pattern.brightness(projector_px[..., 0], projector_px[..., 1]), lit.shape)
        image = _DARK + _GREY * light * lit + rng.normal(0, 1.0, lit.shape)
        file = f"frames/{index:03d}.png"
        write_png(folder / file, np.rint(image).clip(0, 255).astype(np.uint8))
        frames.append({"file": file, "pattern": pattern_to_dict(pattern)})
    listing = {name: {"width": size.width, "height": size.height} for name, size in sizes.items()}
    (folder / "capture.yaml").write_text(yaml.safe_dump({"format": 1, **listing, "frames": frames}))
    return folder


def _seen(network: SyntheticNetwork, camera: str, projector: str) -> tuple[Floats, Bools]:
    """For each camera pixel the projector's pixel (H, W, 2) there, and whether it is lit, (H, W)."""
    width, height = network.devices[camera].size
    row, column = np.indices((height, width), dtype=np.float64)
    at, light = network.poses[camera], network.poses[projector]
    rays = network.devices[camera].unproject(np.stack([column.ravel(), row.ravel()], axis=1))
    points, _ = cast(at.rotate(rays), at.translation, network.scene)
    from_light = points - light.translation
    met, _ = cast(from_light, light.translation, network.scene)
    before = from_light @ light.rotation
    size = np.array(network.devices[projector].size)
    with np.errstate(invalid="ignore", divide="ignore"):
        projector_px = network.devices[projector].project(before)
        lit = (np.linalg.norm(met - points, axis=1) < _NEAR_M) & (before[:, 2] > 0)
        lit &= np.all((projector_px > -0.5) & (projector_px < size - 0.5), axis=1)
    return np.nan_to_num(projector_px).reshape(height, width, 2), lit.reshape(height, width)
