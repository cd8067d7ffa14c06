"""A result folder with everything known, written in a fraction of a second."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.geometry.camera import Intrinsics
from calib.numerics.array_types import Bools, Floats
from calib.pointcloud.organised_cloud import build_cloud
from scanner.io.calibration_file import write_calibration
from scanner.io.matches_file import write_matches
from scanner.io.ply import write_ply
from scanner.results.finished_scan import FinishedScan, read_finished_scan
from tests.support.cloud_scene import CAMERA, PROJECTOR, Scene, room


@dataclass(frozen=True)
class Written:
    """The folder, what is in it, and the scene it was made from."""

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
) -> Written:
    """What a scan of the scene would have left, with the true calibration; `keep` chooses among the camera pixels."""
    scene = room(camera, projector, noise_px)
    if keep:
        scene = replace(scene, matches=scene.matches[keep(scene.matches.camera_px)])
    calibration = replace(scene.calibration, unit=unit)
    folder.mkdir(parents=True)
    write_matches(folder / "matches.npz", replace(scene.matches, sigma_px=np.full(len(scene.matches), noise_px)))
    write_calibration(folder / "calibration.yaml", calibration)
    write_ply(folder / "cloud.ply", build_cloud(scene.matches, scene.texture, calibration))
    return Written(folder, read_finished_scan(folder), scene)
