"""Reports of synthetic scenes, for tests of the page and tests in a browser."""

from dataclasses import replace

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Corner, DeviceSigmas, Matches, Sigmas, Size
from calib.pointcloud import build_cloud
from calib.refusal import RefusalError
from calib.self_calibration import Profile, SelfCalibration
from scanner.capture import CaptureMetadata
from scanner.decoding import TOO_DARK, Decoding, MaskReason
from scanner.decoding.light import NoiseModel
from scanner.patterns import sequence_for
from scanner.reporting import ReportInput
from scanner.results import Decoded, Reconstructed, Refused, SelfCalibrated
from tests.support.cloud_scene import Scene
from tests.support.findings import FOR_TESTS

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
