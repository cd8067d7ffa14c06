"""`scan board`: from captures, live, printing, and messages on wrong input.

The plot of where boards were in a picture.
"""

import re
from base64 import b64decode
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards import Board, calibrate_boards
from calib.geometry import Size
from calib.synthetic import random_boards
from scanner.boards.calibrate import BoardCapture, FromBoards, Missing
from scanner.boards.result import _coverage, save_result
from scanner.commands import main
from scanner.configuration import Config
from scanner.errors import StorageError
from scanner.io import read_calibration
from scanner.results import new_result, read_verdict
from scanner.targets import Target
from tests.support.board_captures import views_of
from tests.support.little_memory import no_file_larger_than
from tests.support.places import REAL_CAPTURES

BOARDS = REAL_CAPTURES / "procam-calibration"
TARGET = Target("chessboard", 9, 7, 30.0)


@pytest.fixture(scope="module")
def from_boards() -> FromBoards:
    boards = random_boards(np.random.default_rng(4), views=4, matches=3000)
    rig = boards.calibration
    found = calibrate_boards(views_of(boards), rig.camera.size, rig.projector.size, Board(boards.reach, 2, "mm"))
    white = np.full((rig.camera.height, rig.camera.width), 200, np.uint8)
    seen = tuple(BoardCapture(white, view) for view in found.estimate.views)
    missing = (Missing("view 9", "no chessboard:9x7 was found"),)
    return FromBoards(TARGET, seen, missing, found)


def test_the_result_is_a_calibration_and_a_page(from_boards: FromBoards, tmp_path: Path) -> None:
    save_result(from_boards, tmp_path)
    found = from_boards.calibrated
    read = read_calibration(tmp_path / "calibration.yaml")
    assert read.camera == found.calibration.camera
    assert read.sigma.projector == found.calibration.sigma.projector
    verdict = read_verdict(tmp_path / "calibration.yaml")
    assert verdict.grade in ("good", "fair")
    sigmas = read.sigma.camera, read.sigma.projector
    for number, device, sigma in zip(
        re.findall(r"([\d.]+) %", verdict.reasons[0]), (read.camera, read.projector), sigmas, strict=True
    ):
        assert sigma.focal_px is not None
        assert float(number) == pytest.approx(100 * sigma.focal_px[0] / device.focal_px[0], rel=0.06)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for told in (
        f"{verdict.sign} {verdict.headline}",
        "Each board, predicted by the others",
        "view 3",
        "view 9 is not used",
        "Half of the boards",
    ):
        assert told in page
    assert "://" not in re.sub(r"data:image/jpeg;base64,[^\"]*", "", page)


@pytest.mark.parametrize("largest_file", [500, 20_000])
def test_a_full_disk_leaves_no_incomplete_result(from_boards: FromBoards, tmp_path: Path, largest_file: int) -> None:
    """The calibration, or the page, is the first file that does not fit."""
    out = tmp_path / "board"
    with (
        pytest.raises(StorageError) as caught,
        new_result(out, Config(), overwrite=False) as folder,
        no_file_larger_than(largest_file),
    ):
        save_result(from_boards, folder)
    assert str(out) in str(caught.value)
    assert "partial" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_corners_of_a_large_camera_are_drawn_at_their_places(from_boards: FromBoards, tmp_path: Path) -> None:
    camera = from_boards.calibrated.calibration.camera.size
    assert camera.width > 1000
    save_result(from_boards, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    pictures = re.findall(r"data:image/jpeg;base64,([^\"]*)", page)
    for encoded, seen in zip(pictures, from_boards.captures, strict=True):
        picture = cv2.imdecode(np.frombuffer(b64decode(encoded), np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape[0] < picture.shape[1] < 500
        orange = np.argwhere(picture[..., 0] < 150)[:, ::-1]
        there = (seen.view.corners_px + 0.5) * picture.shape[1] / camera.width - 0.5
        away = np.linalg.norm(orange[:, None] - there, axis=-1)
        assert 0 <= away.min(axis=0).max() < 1.5
        assert 0.5 < away.min(axis=1).max() < 3.5


@pytest.mark.parametrize("text", ["charuco:A4", "chessboard:9x7@A3 --square 25mm", "acircles:4x9@A4 --square 30mm"])
def test_the_printed_page_has_its_true_size(text: str, tmp_path: Path) -> None:
    out = tmp_path / "board.pdf"
    assert main(["board", "--print", *text.split(), "--out", str(out), "--quiet"]) == 0
    box = re.search(rb"/MediaBox \[ *([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+)", out.read_bytes())
    size_mm = np.sort([float(side) * 25.4 / 72 for side in box.groups()[2:]])
    expected = (297, 420) if "A3" in text else (210, 297)
    assert np.abs(size_mm - expected).max() < 0.1
    assert main(["board", "--print", *text.split(), "--out", str(out), "--quiet"]) == 2


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("", "expected captures of a board"),
        (". --square 10mm", "expected --board and --square"),
        (". --board chessboard:9x7", "expected --board and --square"),
        ("nowhere --board chessboard:9x7 --square 10mm", "no such capture"),
        (". --board chessboard:9x7 --square 10ells", "ells"),
        (". --board chessboard:9x7 --square 1e300m", "expected a length of 1e-06 to 10000 m"),
        (". --board chessboard:9x7 --square 1e-300mm", "expected a length of 1e-06 to 10000 m"),
        ("--print charuco:A4 --square 60mm", "more than A4 leaves"),
        ("--print chessboard:9x7", "--square"),
    ],
)
def test_wrong_arguments_are_reported(
    arguments: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["board", *arguments.split()]) == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not BOARDS.is_dir(), reason=f"the real captures are not there: {BOARDS}")
@pytest.mark.xdist_group("real-captures")
def test_real_boards_predict_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, some = tmp_path / "boards", tmp_path / "captures"
    some.mkdir()
    for number in (0, 2, 4):
        (some / f"capture_{number}").symlink_to(BOARDS / f"capture_{number}")
    assert main(["board", str(some), "--board", "chessboard:9x7", "--square", "75mm", "--out", str(out)]) == 0
    calibration = read_calibration(out / "calibration.yaml")
    # Local homographies and stereoCalibrate: 3455 and 1896 px, moving by 0.7 % with a board left out.
    assert 3415 < calibration.camera.focal_px[0] < 3465
    assert 1865 < calibration.projector.focal_px[0] < 1900
    assert 1.0 < calibration.sigma.camera.focal_px[0] < 10.0
    told = re.search(r"by the others to ([\d.]+) projector px", capsys.readouterr().out)
    assert 0.02 < float(told[1]) < 0.4  # by only two others


@pytest.mark.parametrize("size", [Size(200, 150), Size(4096, 3000), Size(3000, 4096)])
def test_dots_are_seen_and_hide_no_other(size: Size) -> None:
    """Each is where its corner is, and its diameter a hundredth of the longer side."""
    pixels = np.array([[0.1, 0.1], [0.5, 0.5], [0.9, 0.3]]) * size
    svg = str(_coverage([pixels[:2], pixels[2:]], size, "Corners"))
    dots = np.array(re.findall(r'<circle cx="([-\d.]+)" cy="([-\d.]+)" r="([-\d.]+)"/>', svg), np.float64)
    assert dots.shape == (3, 3)
    np.testing.assert_allclose(dots[:, :2], pixels, rtol=0, atol=0.5)
    assert (0.003 * max(size) < dots[:, 2]).all()
    assert (dots[:, 2] < 0.006 * max(size)).all()
    assert f'viewBox="0 0 {size.width} {size.height}"' in svg
