"""The smallest capture folder, of a camera that sees exactly what the projector shows; and rooms scanned in seconds."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from calib.geometry import Size
from scanner.io import write_png
from scanner.patterns import Pattern, draw, pattern_to_dict, sequence_for

CONFIG = """
rig: {backend: simulated, furniture: false, interreflection: false, ambient: 0}
camera: {width: 306, height: 256, principal_point: {known: [157.04, 131.79]}}
projector: {width: 214, height: 120}
sequence: {preset: quick}
corner: {squareness_deg: 0}
"""


def with_few_rays(patch: pytest.MonkeyPatch) -> None:
    """Let an eighth of the rays gather the indirect light of rooms: these are made in half of the time."""
    patch.setattr("hw.simulated.renderer._RAYS_PER_NODE", 48)


SIZE = Size(48, 32)
PATTERNS = sequence_for(SIZE, cell=8, shifts=3)


def write_capture(folder: Path, patterns: tuple[Pattern, ...] = PATTERNS) -> Path:
    """Write a capture of `patterns`, for a test to damage."""
    (folder / "frames").mkdir(parents=True)
    frames = []
    for index, pattern in enumerate(patterns):
        file = f"frames/{index:03d}.png"
        write_png(folder / file, draw(pattern, SIZE) // 2 + 20)
        frames.append({"file": file, "pattern": pattern_to_dict(pattern)})
    size = {"width": SIZE[0], "height": SIZE[1]}
    write_listing(folder, {"format": 1, "projector": size, "camera": size, "frames": frames})
    return folder


def read_listing(folder: Path) -> dict[str, Any]:
    return yaml.safe_load((folder / "capture.yaml").read_text())


def write_listing(folder: Path, listing: dict[str, Any]) -> None:
    (folder / "capture.yaml").write_text(yaml.safe_dump(listing))
