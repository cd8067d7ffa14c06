"""Result folders and reports of synthetic scenes with ground truth, written in a fraction of a second."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Corner, DeviceSigmas, Intrinsics, Matches, Pose, Sigmas, Size
from calib.numerics import Bools, Floats
from calib.pointcloud import build_cloud
from calib.refusal import RefusalError
from calib.self_calibration import Profile, SelfCalibration
from scanner.capture import CaptureMetadata
from scanner.decoding import TOO_DARK, Decoding, MaskReason
from scanner.decoding.light import NoiseModel
from scanner.io import (
    read_calibration,
    read_matches,
    write_calibration,
    write_matches,
    write_merged_ply,
    write_ply,
    write_poses,
)
from scanner.patterns import sequence_for
from scanner.reporting import ReportInput
from scanner.results import Decoded, FinishedScan, Reconstructed, Refused, SelfCalibrated, read_finished_scan
from tests.support.cloud_scene import CAMERA, FIRST_PLACE, PROJECTOR, Scene, room
from tests.support.findings import FOR_TESTS


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


def write_captures(folder: Path, camera: Intrinsics = CAMERA) -> tuple[Written, Written]:
    """The result of two captures of the corner by one rig, from two places, the older first; the merged cloud holds
    every point of both.
    """
    older = write_result(folder / "captures" / "1", camera=camera, at=(1.2, 1.5, 1.3))
    captures = older, write_result(folder, camera=camera)
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


SIZES = (Size(408, 342), Size(854, 480))
DARK = Finding(TOO_DARK, Severity.WARNING, "Some frames are dark.", "Expose longer.", {"noise_ratio": 12.0})
OFF_SQUARE = Finding(
    FindingKind("off-square", "How far the faces seem to be from square."),
    Severity.NOTE,
    "The faces seem to be off by +0.10 degrees.",
)


def decoding_of(scene: Scene) -> Decoding:
    reasons = np.full(scene.texture.shape[:2], MaskReason.DARK, dtype=np.uint8)
    column, row = scene.matches.camera_px.astype(int).T
    reasons[row, column] = MaskReason.KEPT
    reasons[:20] = MaskReason.SATURATED
    return Decoding(scene.matches, scene.texture, reasons, NoiseModel(2.0, 0.01), 0.8, (DARK,))


def calibrated_report(scene: Scene) -> ReportInput:
    camera = replace(scene.calibration.camera, focal_px=(299.5, 299.5))
    sigma = Sigmas(DeviceSigmas((4.0, 4.0), (0.0, 0.0)), DeviceSigmas((11.0, 11.0), (2.0, 3.0)))
    calibration = replace(scene.calibration, camera=camera, sigma=sigma)
    focal_px = np.geomspace(120, 1600, 60)
    decoding = decoding_of(scene)
    solution = SelfCalibration(
        calibration.in_baselines,
        scene.matches,
        Corner(scene.corner.vertex / calibration.baseline, scene.corner.legs),
        Profile(focal_px, 400 * np.log(focal_px / 299.5) ** 2),
        0.083,
        "refined",
        (OFF_SQUARE,),
    )
    metadata = CaptureMetadata(*SIZES, sequence_for(SIZES[1]), {"camera": "Simulated"}, (33333.0, 33333.0))
    calibrated = SelfCalibrated(Decoded(metadata, scene.matches, decoding), solution, calibration)
    cloud = build_cloud(scene.matches, scene.texture, calibration)
    # The focal length above was made up to be off; a real calibration's rays meet better than that.
    cloud = replace(cloud, statistics=replace(cloud.statistics, calibration_px=0.06))
    return ReportInput(Reconstructed(calibrated, cloud), scene.calibration)


def refused_report(scene: Scene) -> ReportInput:
    refusal = RefusalError(FOR_TESTS, "The faces are not square.", "Choose another corner.")
    matches = Matches(scene.matches.camera_px, scene.matches.projector_px)
    return ReportInput(Refused(Decoded(CaptureMetadata(*SIZES), matches, decoding_of(scene)), refusal))
