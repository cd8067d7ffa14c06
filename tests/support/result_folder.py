"""A result folder with ground truth, written in a fraction of a second."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.geometry import Intrinsics
from calib.numerics import Bools, Floats
from calib.pointcloud import build_cloud
from scanner.io import read_calibration, read_matches, write_calibration, write_matches, write_ply
from scanner.results import FinishedScan, read_finished_scan
from tests.support.cloud_scene import CAMERA, PROJECTOR, Scene, room


@dataclass(frozen=True)
class Written:
    """The folder, its content, and its scene."""

    folder: Path
    scan: FinishedScan
    scene: Scene


def enlarge(folder: Path, factor: int) -> None:
    """Change the result in a folder to one whose camera's pixels are `factor` times as fine, with the same matches: few
    in a huge image.
    """
    calibration = read_calibration(folder / "calibration.yaml")
    camera = calibration.camera
    x_0, y_0 = ((value + 0.5) * factor - 0.5 for value in camera.principal_point_px)
    focal_px = camera.focal_px[0] * factor, camera.focal_px[1] * factor
    finer = Intrinsics(camera.width * factor, camera.height * factor, focal_px, (x_0, y_0), camera.distortion)
    write_calibration(folder / "calibration.yaml", replace(calibration, camera=finer))
    matches = read_matches(folder)
    write_matches(folder / "matches.npz", replace(matches, camera_px=(matches.camera_px + 0.5) * factor - 0.5))


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
