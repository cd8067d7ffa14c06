"""Several captures of one rig on the command line: matches of synthetic corners, and wrong ones."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import NO_FACE, Calibration, Intrinsics, Matches, Pose, Size
from calib.synthetic import PAPER_PROJECTOR, SyntheticCapture, random_captures
from scanner.io import read_calibration, read_matches, write_calibration, write_matches
from scanner.quantities import intrinsic_errors_percent
from scanner.reconstruction import read_captures
from scanner.results import read_uncertainty, read_verdict
from tests.support.command_line import names, run
from tests.support.known_rigs import SMALL_CAMERA
from tests.support.small_capture import SIZE, write_capture

CONFIG = """
camera: {width: 612, height: 512, principal_point: {known: [313.7, 263.2]}}
projector: {width: 854, height: 480}
corner: {squareness_deg: 0}
"""
SIZES = SMALL_CAMERA.size, Size(854, 480)

pytestmark = pytest.mark.xdist_group("several captures")


@dataclass(frozen=True)
class Given:
    """Files `a.npz`, `b.npz` with matches of one corner from two places, and a configuration."""

    folder: Path
    captures: list[SyntheticCapture]

    @property
    def files(self) -> tuple[Path, Path]:
        return self.folder / "a.npz", self.folder / "b.npz"

    @property
    def config(self) -> Path:
        return self.folder / "rig.yaml"


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Given:
    captures = random_captures(np.random.default_rng(5), 2, camera=SMALL_CAMERA, count=1500, noise_px=0.05)
    made = Given(tmp_path_factory.mktemp("given"), captures)
    for file, capture in zip(made.files, captures, strict=True):
        write_matches(file, capture.matches)
    made.config.write_text(CONFIG)
    return made


@pytest.fixture(scope="module")
def together(given: Given, tmp_path_factory: pytest.TempPathFactory) -> tuple[int, Path]:
    out = tmp_path_factory.mktemp("together") / "result"
    return run("calibrate", *given.files, "--config", given.config, "--out", out, "--quiet"), out


def test_each_capture_is_a_result_of_its_own(given: Given, together: tuple[int, Path]) -> None:
    code, out = together
    assert code == 0
    files = {"calibration.yaml", "cloud.ply", "matches.npz", "report.html"}
    assert names(out) == files | {"captures", "scan.log"}
    assert names(out / "captures") == {"1"}
    assert names(out / "captures" / "1") == files
    for folder, capture in ((out / "captures" / "1", given.captures[0]), (out, given.captures[1])):
        np.testing.assert_array_equal(read_matches(folder).camera_px, capture.matches.camera_px)
    newest, older = ((folder / "calibration.yaml").read_text() for folder in (out, out / "captures/1"))
    assert newest.partition("made:")[0] == older.partition("made:")[0]
    error = intrinsic_errors_percent(read_calibration(out / "calibration.yaml"), given.captures[0].calibration)
    assert 1e-3 < np.abs(error).mean() < 0.5


def test_the_report_is_of_all_captures(together: tuple[int, Path]) -> None:
    _, out = together
    report = (out / "report.html").read_text().replace("\N{NO-BREAK SPACE}", " ")
    for words in (
        "2 captures together",
        '<a href="captures/1/report.html">Capture 1: ',
        "/a.npz</a>",
        "Capture 2: ",
        "/b.npz",
        "If it is elsewhere: 10 px",
    ):
        assert words in report
    assert "was not merged" not in report
    assert "calibrated together with others" in (out / "captures/1/report.html").read_text()


def test_the_calibration_file_states_its_uncertainty(together: tuple[int, Path]) -> None:
    _, out = together
    path = out / "calibration.yaml"
    verdict, calibration = read_verdict(path), read_calibration(path)
    assert verdict is not None
    assert f" {verdict.headline}</h2>" in (out / "report.html").read_text()
    uncertainty = read_uncertainty(path, calibration)
    assert uncertainty is not None
    sigma_px = np.sqrt(uncertainty.covariance[0, 0]) * calibration.camera.focal_px[0]
    assert sigma_px == pytest.approx(calibration.sigma.camera.focal_px[0])


def test_faces_are_numbered_consistently(given: Given, together: tuple[int, Path]) -> None:
    """Clockwise around the vertex in every capture, so that only the first may differ."""
    _, out = together
    for folder, capture in ((out / "captures" / "1", given.captures[0]), (out, given.captures[1])):
        face, before = read_matches(folder).face, capture.matches.face
        assert face is not None
        assert before is not None
        new = [int(np.median(face[before == label])) for label in range(3)]
        assert sorted(new) == [0, 1, 2]
        for label in range(3):
            assert np.all(face[before == label] == new[label])
        legs = capture.corner.legs[np.argsort(new)]
        assert np.linalg.det(legs) < 0


def test_ambiguous_bare_walls_are_not_merged(together: tuple[int, Path]) -> None:
    _, out = together
    assert not (out / "merged.ply").exists()
    assert "The clouds were not merged" in (out / "scan.log").read_text()


def test_a_result_of_several_stands_for_all(given: Given, together: tuple[int, Path]) -> None:
    _, out = together
    again = read_captures([out], *SIZES)
    assert [len(found.matches) for found in again] == [len(capture.matches) for capture in given.captures]
    assert [found.name for found in again] == [str(out / "captures" / "1"), str(out)]


def few_on_a_face(matches: Matches) -> Matches:
    assert matches.face is not None
    third = np.flatnonzero(matches.face == 2)
    face = matches.face.copy()
    face[third[3:]] = NO_FACE
    return matches.with_faces(face)


def two_faces(matches: Matches) -> Matches:
    assert matches.face is not None
    return matches.with_faces(np.where(matches.face == 2, NO_FACE, matches.face).astype(np.int32))


def of_another_camera(matches: Matches) -> Matches:
    return Matches(2 * matches.camera_px, matches.projector_px, matches.face)


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (few_on_a_face, 4, ("b.npz: A face of the corner has 3 matches", "leave this capture out")),
        (two_faces, 2, ("b.npz: 'face' must label three faces, found 2",)),
        (of_another_camera, 2, ("b.npz: camera_px runs", "camera.width is 612")),
        (lambda matches: matches[:300].with_faces(None), 4, ("b.npz: Only 300 matches",)),
    ],
)
def test_the_wrong_capture_is_named(
    given: Given,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[Matches], Matches],
    code: int,
    words: tuple[str, ...],
) -> None:
    write_matches(tmp_path / "b.npz", change(given.captures[1].matches))
    out = tmp_path / "out"
    assert run("calibrate", given.files[0], tmp_path / "b.npz", "--config", given.config, "--out", out) == code
    output = capsys.readouterr()
    assert output.out == ""
    for word in words:
        assert word in output.err
    assert out.exists() == (code == 4)
    if code == 4:
        assert names(out) == {"matches.npz", "refused.yaml", "report.html", "scan.log", "captures"}
        assert names(out / "captures/1") == {"matches.npz", "refused.yaml", "report.html"}


def test_the_same_capture_twice_is_refused(given: Given, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "copy.npz").write_bytes(given.files[0].read_bytes())
    for second in (given.files[0], tmp_path / "copy.npz"):
        arguments = ("--config", given.config, "--out", tmp_path / "out")
        assert run("calibrate", given.files[0], second, *arguments) == 2
        assert f"{second}: holds the same matches as {given.files[0]}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_result_of_another_camera_is_refused(
    given: Given, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tmp_path / "result"
    result.mkdir()
    write_matches(result / "matches.npz", given.captures[1].matches)
    camera = Intrinsics(1224, 1024, (900.0, 900.0), (600.0, 500.0))
    write_calibration(
        result / "calibration.yaml", Calibration(camera, PAPER_PROJECTOR, Pose(np.eye(3), np.array([1.0, 0.0, 0.0])))
    )
    arguments = ("--config", given.config, "--out", tmp_path / "out")
    assert run("calibrate", given.files[0], result, *arguments) == 2
    assert f"{result}: its camera is 1224 × 1024, but 612 × 512 is expected" in capsys.readouterr().err


def test_a_recording_of_another_size_is_refused(
    given: Given, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tmp_path / "result"
    write_capture(result / "capture")
    write_matches(result / "matches.npz", given.captures[1].matches)
    assert run("calibrate", result, "--config", given.config, "--out", tmp_path / "out") == 2
    assert f"{result}: its camera is {SIZE[0]} × {SIZE[1]}" in capsys.readouterr().err


def test_a_recording_of_another_rig_is_refused(
    given: Given, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_capture(tmp_path / "room")
    assert run("calibrate", tmp_path / "room", "--config", given.config, "--out", tmp_path / "out") == 2
    assert f"{tmp_path / 'room'}: its camera is {SIZE[0]} × {SIZE[1]}" in capsys.readouterr().err


def test_the_method_of_the_paper_takes_one_capture(
    given: Given, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("--config", given.config, "--set", "method=paper", "--out", tmp_path / "out")
    assert run("calibrate", *given.files, *arguments) == 2
    assert "'method: paper' calibrates from one capture, found 2" in capsys.readouterr().err


def test_earlier_results_are_found_beside_the_configuration(
    given: Given, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "deep" / "rig.yaml"
    config.parent.mkdir()
    config.write_text("earlier: [../one.npz]\n")
    capture = write_capture(tmp_path / "room")
    assert run("replay", capture, "--config", config, "--out", tmp_path / "out") == 2
    assert f"{config.parent / '../one.npz'}: no such matches file" in capsys.readouterr().err
    write_matches(tmp_path / "one.npz", given.captures[0].matches)
    assert run("replay", capture, "--config", config, "--out", tmp_path / "out") == 2
    assert "one.npz: camera_px runs" in capsys.readouterr().err
    calibration = tmp_path / "calibration.yaml"
    device = Intrinsics(*SIZE, (50.0, 50.0), (24.0, 16.0))
    write_calibration(calibration, Calibration(device, device, Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))))
    arguments = ("--config", config, "--calibration", calibration, "--out", tmp_path / "out")
    assert run("replay", capture, *arguments) == 2
    assert "--set earlier=[]" in capsys.readouterr().err
