"""Reports of several captures, of the uncertainty of points, and of an assumption."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.diagnostics import Uncertainty
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Corner, Matches, Pose, unproject
from calib.pointcloud import CornerView, build_cloud, merged
from calib.refinement import CAMERA as CAMERA_COLUMNS
from calib.refinement import PROJECTOR as PROJECTOR_COLUMNS
from calib.refinement import SHARED, State
from calib.self_calibration import Profile, SelfCalibration
from scanner.capture import CaptureMetadata
from scanner.reporting.contents import CaptureRow, JointCaptures, ReportInput
from scanner.reporting.focal import focal_length
from scanner.reporting.page import write_report
from scanner.reporting.uncertainty import effect_of_principal_point, point_sigmas
from scanner.reporting.verdict import verdict
from scanner.results import Decoded, GivenMatches, Reconstructed, SelfCalibrated
from tests.support.cloud_scene import CAMERA, PROJECTOR, Scene, room

SIGMA_F = 0.01

MERGED_CLOUDS = Finding(FindingKind("merged", "Merged."), Severity.NOTE, "The 2 clouds are merged.")


def state_of(calibration: Calibration) -> State:
    camera, projector = (
        np.array([device.focal_px[0], *device.principal_point_px, *device.distortion])
        for device in (calibration.camera, calibration.projector)
    )
    translation = calibration.pose.translation / calibration.baseline
    return State(camera, projector, Pose(calibration.pose.rotation, translation), np.zeros((1, 3)), ())


@pytest.fixture(scope="module")
def scene() -> Scene:
    return room()


@pytest.fixture(scope="module")
def report(scene: Scene) -> ReportInput:
    """A calibration that is certain except for the camera's focal length, whose sigma is one per cent."""
    covariance = np.zeros((SHARED, SHARED))
    covariance[0, 0] = SIGMA_F**2
    by_principal_point = np.zeros((SHARED, 2))
    by_principal_point[0] = 0.001, -0.0002
    by_principal_point[PROJECTOR_COLUMNS.start] = 0.0005, 0.0
    baseline = scene.calibration.baseline
    calibration = scene.calibration.scaled(1 / baseline, "baseline")
    solution = SelfCalibration(
        calibration,
        scene.matches,
        Corner(scene.corner.vertex / baseline, scene.corner.legs),
        Profile(np.linspace(200, 400, 9), np.linspace(-4, 4, 9) ** 2),
        0.1,
        "refined",
        uncertainty=Uncertainty(state_of(scene.calibration), covariance, by_principal_point, 1e-4),
    )
    cloud = build_cloud(scene.matches, scene.texture, calibration)
    view = CornerView(cloud.points, None, CAMERA, solution.corner)
    decoded = Decoded(CaptureMetadata(CAMERA.size, PROJECTOR.size), scene.matches, GivenMatches(scene.texture))
    rows = (
        CaptureRow("capture 1", "captures/1/report.html", 1234, 0.0712, cloud.statistics, calibration),
        CaptureRow("capture <2>", "", 5678, None, None),
    )
    joint = JointCaptures(2, rows, merged([cloud, cloud], [view, view], (0, 0)), (MERGED_CLOUDS,))
    return ReportInput(Reconstructed(SelfCalibrated(decoded, solution, calibration), cloud), joint=joint)


@pytest.fixture(scope="module")
def page(report: ReportInput, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, report)
    return path.read_text()


def test_the_report_lists_the_captures_and_shows_their_cloud(page: str) -> None:
    for words in (
        "from 2 captures together",
        '<a href="captures/1/report.html">capture 1</a>',
        "capture &lt;2&gt;",
        "1,234",
        "0.071 px",
        "The 2 clouds are merged.",
        "the merged point cloud, top view",
    ):
        assert words in page, words
    order = re.findall(r'<section id="(\w+)"', page)
    assert order == [
        "calibration",
        "captures",
        "faces",
        "cloud",
        "profile",
        "sigmas",
        "flatness",
        "residuals",
        "misses",
        "capture",
    ]


def test_a_single_capture_has_no_list(report: ReportInput, tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", replace(report, joint=JointCaptures()))
    alone = (tmp_path / "report.html").read_text()
    assert 'id="captures"' not in alone
    assert "captures together" not in alone


def test_point_sigmas_match_trials(report: ReportInput, scene: Scene) -> None:
    """The camera's focal length is varied; per sigma, points move by theirs."""
    found = point_sigmas(report)
    assert found is not None
    assert found.map.scale.low.endswith(" %")
    state = state_of(scene.calibration)
    moved = state.moved(np.where(np.arange(state.size) == CAMERA_COLUMNS.start, 1e-4, 0.0))
    before, after = (_triangulated(each, scene.matches) for each in (state, moved))
    change = np.linalg.norm(after - before, axis=1) / np.linalg.norm(before, axis=1) / 1e-4
    assert found.median_percent == pytest.approx(100 * SIGMA_F * np.median(change), rel=0.05)


def _triangulated(state: State, matches: Matches) -> np.ndarray:
    """The point of the camera's ray closest to the projector's."""
    rays, q = unproject(state.camera, matches.camera_px)[0], unproject(state.projector, matches.projector_px)[0]
    turned = state.pose.rotate(rays)
    a, b, c = (np.sum(x * y, axis=1) for x, y in ((turned, turned), (turned, q), (q, q)))
    depth = (b * (q @ state.pose.translation) - c * (turned @ state.pose.translation)) / (a * c - b * b)
    return rays * depth[:, None]


def test_the_cost_of_an_assumed_principal_point(report: ReportInput) -> None:
    (sentence,) = effect_of_principal_point(report.solution).sentences
    assert "10 px in x would move the camera's focal length by +1.00 % and the projector's by +0.50 %" in sentence
    assert "10 px in y would move the camera's focal length by −0.20 %" in sentence
    assert report.solution is not None
    assert report.solution.uncertainty is not None
    estimated = replace(report.solution.uncertainty, by_principal_point=None)
    assert effect_of_principal_point(replace(report.solution, uncertainty=estimated)).sentences == ()
    assert effect_of_principal_point(None).sentences == ()


def test_a_method_without_sigmas_has_no_map(report: ReportInput) -> None:
    assert isinstance(report.outcome, Reconstructed)
    assert isinstance(report.outcome.calibrated, SelfCalibrated)
    unsure = replace(report.outcome.calibrated.solution, uncertainty=None)
    calibrated = replace(report.outcome.calibrated, solution=unsure)
    assert point_sigmas(replace(report, outcome=replace(report.outcome, calibrated=calibrated))) is None


def test_without_distortion_the_papers_objective_is_lowest_near_the_truth(report: ReportInput) -> None:
    """With lenses as bent as these it would be 27 % off. Of the minima, one is marked there."""
    found = focal_length(report)
    assert found is not None
    assert found.objective is not None
    marked = [int(focal) for focal in re.findall(r">(\d+)</text>", found.objective)]
    assert 1e-4 < min(abs(focal / CAMERA.focal_px[0] - 1) for focal in marked) < 0.02


def test_the_advice_knows_how_many_captures_there_were(report: ReportInput) -> None:
    assert "A further capture" in verdict(report).advice
    assert "--captures 3" in verdict(replace(report, joint=JointCaptures())).advice
