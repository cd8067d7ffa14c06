"""A result folder with ground truth, written in a fraction of a second."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.geometry import Intrinsics
from calib.numerics import Bools, Floats
from calib.pointcloud import build_cloud
from scanner.io import write_calibration, write_matches, write_ply
from scanner.results import FinishedScan, read_finished_scan
from tests.support.cloud_scene import CAMERA, PROJECTOR, Scene, room


@dataclass(frozen=True)
class Written:
    """The folder, its content, and its scene."""

    folder: Path
    scan: FinishedScan
    scene: Scene


def write_result(
    folder: Path,
    *,
    camera: Intrinsics = CAMERA,
    projector: Intrinsics = PROJECTOR,
    unit: str = "m",
    noise_px: float = 0.05,
    keep: Callable[[Floats], Bools] | None = None,
    numbered: bool = True,
) -> Written:
    """The result of a scan of the scene, with the true calibration; `keep` selects camera pixels.

    If not `numbered`, the cloud lacks the numbers of its matches, as in older versions.
    """
    scene = room(camera, projector, noise_px)
    if keep:
        scene = replace(scene, matches=scene.matches[keep(scene.matches.camera_px)])
    calibration = replace(scene.calibration, unit=unit)
    folder.mkdir(parents=True)
    write_matches(folder / "matches.npz", replace(scene.matches, sigma_px=np.full(len(scene.matches), noise_px)))
    write_calibration(folder / "calibration.yaml", calibration)
    cloud = build_cloud(scene.matches, scene.texture, calibration)
    write_ply(folder / "cloud.ply", cloud, match=cloud.match if numbered else None)
    return Written(folder, read_finished_scan(folder), scene)
