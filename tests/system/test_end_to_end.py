"""The commands on a small simulated room: their files, and their accuracy."""

import re
import shutil
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.finding import of_kinds
from calib.geometry import NO_FACE, Pose, Sigmas, rotation_about
from calib.pointcloud import NONE, index_grid
from calib.scene import CALIBRATION_CHANGED
from hw.settings import SimulatedRigSettings
from hw.simulated import place_room
from scanner.capture import open_capture
from scanner.configuration import load_config
from scanner.io import read_calibration, read_matches, read_yaml, write_calibration, write_matches, write_png
from scanner.quantities import intrinsic_errors_percent
from scanner.results import read_finished_scan, read_verdict
from tests.support.command_line import names, run
from tests.support.small_capture import read_listing, with_few_rays, write_listing

CONFIG = """
rig: {backend: simulated, seed: 0, furniture: false}
camera: {width: 612, height: 512, principal_point: {known: [314.1, 263.6]}}
projector: {width: 427, height: 240}
corner: {squareness_deg: 0}
"""

CALIBRATED = {"calibration.yaml", "cloud.ply", "matches.npz", "report.html", "scan.log"}

pytestmark = pytest.mark.xdist_group("end to end")


@dataclass(frozen=True)
class Scanned:
    config: Path
    result: Path
    exit_code: int


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Scanned:
    folder = tmp_path_factory.mktemp("scan")
    config, result = folder / "room.yaml", folder / "result"
    config.write_text(CONFIG)
    with pytest.MonkeyPatch.context() as patch:
        with_few_rays(patch)
        return Scanned(config, result, run("--config", config, "--out", result, "--quiet"))


@dataclass(frozen=True)
class Replayed:
    result: Path
    said: str


@pytest.fixture(scope="module")
def replayed_with_truth(scanned: Scanned) -> Replayed:
    """The capture with the true calibration, with which it is only triangulated."""
    out, truth = scanned.result.parent / "with-truth", scanned.result / "truth.yaml"
    with redirect_stdout(StringIO()) as said:
        assert run("replay", scanned.result / "capture", "--calibration", truth, "--out", out) == 0
    return Replayed(out, said.getvalue())


def test_a_scan_is_complete_and_accurate(scanned: Scanned) -> None:
    assert scanned.exit_code == 0
    assert names(scanned.result) == CALIBRATED | {"capture", "truth.yaml"}
    found, truth = (read_calibration(scanned.result / name) for name in ("calibration.yaml", "truth.yaml"))
    error = np.abs(intrinsic_errors_percent(found, truth)).mean()
    assert 1e-3 < error < 4.3
    assert found.unit == "baseline"
    assert truth.unit == "m"
    assert names(scanned.result.parent) - {"with-truth"} == {"room.yaml", "result"}


def test_ground_truth_holds_the_pose_of_the_rig(scanned: Scanned) -> None:
    told = read_yaml(scanned.result / "truth.yaml")["place"]
    room = place_room(SimulatedRigSettings(seed=0, furniture=False), (612, 512), (427, 240))
    assert np.array(told["translation"]) == pytest.approx(room.camera.centre)
    assert np.array(told["rotation"]) == pytest.approx(room.camera.rotation.T)


def test_a_result_states_its_origin(scanned: Scanned) -> None:
    made = read_yaml(scanned.result / "calibration.yaml")["made"]
    assert made["name"] == "result"
    assert made["program"] == f"roomscan {version('roomscan')}"
    assert made["configuration"] == load_config(scanned.config).model_dump(mode="json", exclude_unset=True)
    assert made["capture"]["backend"] == "simulated"
    assert timedelta(0) < datetime.now(UTC) - datetime.fromisoformat(made["date"]) < timedelta(hours=1)
    report = (scanned.result / "report.html").read_text(encoding="utf-8")
    for words in ("<h1>result</h1>", f"roomscan {version('roomscan')}", '<a href="cloud.ply">', "backend: simulated"):
        assert words in report
    linked = set(re.findall(r'<a href="([^"#:]+)">', report))
    assert linked == names(scanned.result) - {"report.html"}, "and nothing that was only there while it was written"


def test_a_replay_gives_the_same_result(scanned: Scanned, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "replayed"
    assert run("replay", scanned.result / "capture", "--config", scanned.config, "--out", out) == 0
    assert names(out) == CALIBRATED | {"capture"}
    live, replayed = (read_calibration(folder / "calibration.yaml") for folder in (scanned.result, out))
    assert np.allclose(replayed.camera.focal_px, live.camera.focal_px, rtol=1e-9)
    assert open_capture(out / "capture").patterns == open_capture(scanned.result / "capture").patterns
    summary = capsys.readouterr().out
    for words in ("Calibration", "focal length, px", "matches", "points in the cloud", str(out)):
        assert words in summary
    assert "truth" not in summary


def test_a_replay_with_a_known_calibration_only_triangulates(scanned: Scanned, replayed_with_truth: Replayed) -> None:
    out = replayed_with_truth.result
    assert names(out) == CALIBRATED | {"capture"}
    used = read_calibration(out / "calibration.yaml")
    assert used.camera == read_calibration(scanned.result / "truth.yaml").camera
    assert used.unit == "m"
    assert read_matches(out).face is None
    assert b"comment unit m" in (out / "cloud.ply").read_bytes()[:300]
    verdict = read_verdict(out / "calibration.yaml")
    assert verdict is not None
    assert of_kinds(verdict.findings, CALIBRATION_CHANGED) == ()
    assert "no longer holds" not in replayed_with_truth.said


@pytest.mark.parametrize(("turn_deg", "zoom"), [(0.3, 1.0), (0.0, 1.005)])
def test_a_replay_doubts_a_calibration_that_no_longer_holds(
    scanned: Scanned, tmp_path: Path, capsys: pytest.CaptureFixture[str], turn_deg: float, zoom: float
) -> None:
    truth = read_calibration(scanned.result / "truth.yaml")
    (fx, fy), turn = truth.projector.focal_px, rotation_about(np.radians([0.0, turn_deg, 0.0]))
    given = replace(
        truth,
        projector=replace(truth.projector, focal_px=(zoom * fx, zoom * fy)),
        pose=Pose(turn @ truth.pose.rotation, truth.pose.translation),
    )
    write_calibration(tmp_path / "given.yaml", given)
    known = ("--calibration", tmp_path / "given.yaml", "--out", tmp_path / "out")
    assert run("replay", scanned.result / "capture", *known) == 0
    shown = " ".join(capsys.readouterr().out.split())
    verdict = read_verdict(tmp_path / "out" / "calibration.yaml")
    assert verdict is not None
    (finding,) = of_kinds(verdict.findings, CALIBRATION_CHANGED)
    change = "the rotation between them by 0.3°" if turn_deg else "the projector's focal length by 0.5 %"
    assert f"A change of {change} ± 0.0" in finding.message
    assert "with a calibration that no longer holds" in shown
    assert "scan check CAPTURE --calibration FILE --update" in finding.advice
    if turn_deg:
        assert run("replay", scanned.result / "capture", *known, "--overwrite", "--require", "good", "--quiet") == 4


@pytest.fixture(params=["x", "y"])
def one_axis(scanned: Scanned, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """The capture without the patterns of the other axis, and without white and black."""
    capture = tmp_path / "one-axis"
    shutil.copytree(scanned.result / "capture", capture)
    listing = read_listing(capture)
    kept = [frame for frame in listing["frames"] if frame["pattern"].get("axis") == request.param]
    for frame in listing["frames"]:
        if frame not in kept:
            (capture / frame["file"]).unlink()
    write_listing(capture, listing | {"frames": kept})
    return capture


def test_one_axis_is_enough_for_a_known_calibration(
    scanned: Scanned,
    replayed_with_truth: Replayed,
    one_axis: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "one"
    assert run("replay", one_axis, "--calibration", scanned.result / "truth.yaml", "--out", out) == 0
    assert "nothing checks whether the calibration fits" in capsys.readouterr().out
    assert names(out) == CALIBRATED | {"capture"}
    of_one, of_both = read_finished_scan(out), read_finished_scan(replayed_with_truth.result)
    assert 0.97 < len(of_one) / len(of_both) < 1.02
    number = index_grid(of_both.pixel, of_both.calibration.camera.size)[tuple(of_one.pixel.T[::-1])]
    apart = np.linalg.norm(of_one.points - of_both.points[number], axis=1)[number != NONE]
    assert 1e-5 < np.median(apart) < 1e-3  # metres, two metres away
    report = (out / "report.html").read_text()
    assert "with the calibration that was given, which one axis cannot check" in report
    assert "miss each other by" not in report
    # Nothing is calibrated from one axis.
    assert run("calibrate", out, "--config", scanned.config, "--out", tmp_path / "again") == 2
    assert "the other follows from a calibration" in capsys.readouterr().err


def test_one_axis_without_a_calibration_is_not_enough(
    one_axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("replay", one_axis, "--out", tmp_path / "none") == 2
    error = capsys.readouterr().err
    assert "no pattern varies along" in error
    assert "--calibration" in error
    assert not (tmp_path / "none").exists()


def test_one_axis_and_the_calibration_of_another_rig(
    scanned: Scanned, one_axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = yaml.safe_load((scanned.result / "truth.yaml").read_text())
    other["translation"] = [-number for number in other["translation"]]
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(other))
    assert run("replay", one_axis, "--calibration", tmp_path / "other.yaml", "--out", tmp_path / "refused") == 4
    assert "belongs to this rig" in capsys.readouterr().err


def test_matches_are_calibrated_like_a_capture(scanned: Scanned, tmp_path: Path) -> None:
    out = tmp_path / "calibrated"
    arguments = ("--config", scanned.config, "--set", "scale.baseline_m=0.5", "--out", out, "--quiet")
    assert run("calibrate", scanned.result, *arguments) == 0
    assert names(out) == CALIBRATED
    live, again = (read_calibration(folder / "calibration.yaml") for folder in (scanned.result, out))
    assert np.allclose(again.camera.focal_px, live.camera.focal_px, rtol=1e-6)
    assert again.unit == "m"
    assert again.baseline == pytest.approx(0.5)


def test_matches_of_another_decoder_work_with_and_without_labels(scanned: Scanned, tmp_path: Path) -> None:
    matches = read_matches(scanned.result)
    assert matches.face is not None
    live = read_calibration(scanned.result / "calibration.yaml")
    for name, face in (("none", None), ("own", np.where(matches.face == NO_FACE, NO_FACE, 3 * matches.face + 1))):
        file = tmp_path / f"{name}.npz"
        write_matches(file, matches.with_faces(face))
        out = tmp_path / name
        assert run("calibrate", file, "--config", scanned.config, "--out", out, "--quiet") == 0
        again = read_calibration(out / "calibration.yaml")
        assert np.allclose(again.camera.focal_px, live.camera.focal_px, rtol=1e-3)


def test_hand_drawn_faces_are_used(scanned: Scanned, tmp_path: Path) -> None:
    matches = read_matches(scanned.result)
    assert matches.face is not None
    masks = tmp_path / "masks"
    masks.mkdir()
    for label in range(3):
        mask = np.zeros((512, 612), np.uint8)
        column, row = np.rint(matches.on_face(label).camera_px).astype(int).T
        mask[row, column] = 255
        write_png(masks / f"{label}.png", mask)
    out = tmp_path / "masked"
    capture = scanned.result / "capture"
    assert run("replay", capture, "--config", scanned.config, "--masks", masks, "--out", out, "--quiet") == 0
    np.testing.assert_array_equal(read_matches(out).face, matches.face)


def test_the_method_of_the_paper_calibrates(scanned: Scanned, tmp_path: Path) -> None:
    out = tmp_path / "paper"
    arguments = ("--config", scanned.config, "--set", "method=paper", "--out", out, "--quiet")
    assert run("calibrate", scanned.result, *arguments) == 0
    assert read_calibration(out / "calibration.yaml").sigma == Sigmas()


def test_a_refused_capture_keeps_its_matches(
    scanned: Scanned, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    for label in range(3):  # three stripes of whatever is there are no corner
        mask = np.zeros((512, 612), np.uint8)
        mask[:, 200 * label : 200 * label + 180] = 255
        write_png(masks / f"{label}.png", mask)
    out = tmp_path / "refused"
    assert run("replay", scanned.result / "capture", "--masks", masks, "--out", out) == 4
    assert names(out) == {"matches.npz", "refused.yaml", "report.html", "scan.log", "capture"}
    assert len(read_matches(out)) == len(read_matches(scanned.result))
    output = capsys.readouterr()
    assert output.out == ""
    assert "no trustworthy calibration" in output.err
    assert str(out) in output.err


def test_a_calibration_of_another_rig_is_refused(scanned: Scanned, tmp_path: Path) -> None:
    truth = (scanned.result / "truth.yaml").read_text()
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(truth.replace("translation: [", "translation: [1000.0, -1000.0, 0.0] # ["))
    assert run("replay", scanned.result / "capture", "--calibration", wrong, "--out", tmp_path / "out", "--quiet") == 4


@pytest.mark.parametrize(
    ("first", "second"),
    [(0, 1), (2, 3), (4, 8), (5, 14), (-1, -2)],
    ids=["white and black", "bit and inverse", "two bits", "bit and fringe", "two steps of a fringe"],
)
def test_swapped_frames_are_noticed(
    scanned: Scanned, tmp_path: Path, capsys: pytest.CaptureFixture[str], first: int, second: int
) -> None:
    capture = tmp_path / "capture"
    open_capture(scanned.result / "capture").copy_to(capture)
    listing = read_listing(capture)
    a, b = listing["frames"][first], listing["frames"][second]
    a["file"], b["file"] = b["file"], a["file"]
    write_listing(capture, listing)
    assert run("replay", capture, "--config", scanned.config, "--out", tmp_path / "out", "--quiet") == 2
    assert capsys.readouterr().err.startswith("scan: ")
    assert not (tmp_path / "out").exists()
