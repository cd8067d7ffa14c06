"""A result folder with ground truth, written in a fraction of a second."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics, Pose
from calib.numerics import Bools, Floats
from calib.pointcloud import build_cloud
from scanner.io import (
    read_calibration,
    read_matches,
    write_calibration,
    write_matches,
    write_merged_ply,
    write_ply,
    write_poses,
)
from scanner.results import FinishedScan, read_finished_scan
from tests.support.cloud_scene import CAMERA, FIRST_PLACE, PROJECTOR, Scene, room


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
    at: tuple[float, float, float] = FIRST_PLACE,
) -> Written:
    """The result of a scan of the scene, with the true calibration; `keep` selects camera pixels.

    If not `numbered`, the cloud lacks the numbers of its matches, as in older versions.
    """
    scene = room(camera, projector, noise_px, at=at)
    if keep:
        scene = replace(scene, matches=scene.matches[keep(scene.matches.camera_px)])
    calibration = replace(scene.calibration, unit=unit)
    folder.mkdir(parents=True, exist_ok=True)
    write_matches(folder / "matches.npz", replace(scene.matches, sigma_px=np.full(len(scene.matches), noise_px)))
    write_calibration(folder / "calibration.yaml", calibration)
    cloud = build_cloud(scene.matches, scene.texture, calibration)
    write_ply(folder / "cloud.ply", cloud, match=cloud.match if numbered else None)
    return Written(folder, read_finished_scan(folder), scene)


def write_captures(folder: Path) -> tuple[Written, Written]:
    """The result of two captures of the corner by one rig, from two places, the older first; the merged cloud holds
    every point of both.
    """
    captures = write_result(folder / "captures" / "1", at=(1.2, 1.5, 1.3)), write_result(folder)
    poses = [corner_pose(written) for written in captures]
    points, normals, colours = (
        np.concatenate(parts)
        for parts in zip(
            *(
                (pose @ written.scan.points, pose.rotate(written.scan.normals), written.scan.colours)
                for pose, written in zip(poses, captures, strict=True)
            ),
            strict=True,
        )
    )
    write_merged_ply(folder / "merged.ply", MergedPoints(points, normals, colours))
    write_poses(folder / "poses.yaml", poses)
    return captures


def corner_pose(written: Written) -> Pose:
    """The true pose of a camera in the corner's frame."""
    corner = written.scene.corner
    return Pose(corner.legs, -corner.legs @ corner.vertex)


class MergedPoints(NamedTuple):
    """A cloud in the corner's frame, in metres."""

    points: Floats
    normals: Floats
    colours: NDArray[np.uint8]
    unit: str = "m"
