"""`scan board` on unsuitable captures: messages and exit codes."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.geometry import Pose
from calib.synthetic import BoardOptions, SyntheticBoards, random_boards
from scanner.commands import main
from scanner.io import read_image, write_png
from scanner.targets import Target
from tests.support.board_captures import CAMERA, PROJECTOR, write_board_capture

pytestmark = pytest.mark.xdist_group("wrong boards")  # what the module shares is made once

TARGET = Target("chessboard", 7, 5, 0.05)
OPTIONS = BoardOptions(CAMERA, PROJECTOR, 7, 5, 0.05, 3, distance=(0.9, 1.3), matches=1, bend=0.0)


@pytest.fixture(scope="module")
def made() -> SyntheticBoards:
    return random_boards(np.random.default_rng(1), OPTIONS)


@pytest.fixture(scope="module")
def captures(made: SyntheticBoards, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three good captures; a wall without a board; two boards at once; three boards that are parallel."""
    folder = tmp_path_factory.mktemp("captures")
    for number, pose in enumerate(made.poses):
        write_board_capture(folder / f"good/{number}", TARGET, made.calibration, pose)
    # Of a board as large as a house one square is in the picture.
    write_board_capture(folder / "blank", Target("chessboard", 4, 4, 9.0), made.calibration, made.poses[0])
    two = write_board_capture(folder / "two", TARGET, made.calibration, made.poses[0])
    for frame in sorted((two / "frames").iterdir()):
        picture = read_image(frame)
        half = np.asarray(cv2.resize(picture, None, fx=0.5, fy=1.0, interpolation=cv2.INTER_AREA), np.uint8)
        write_png(frame, np.hstack([half, half]))
    flat = random_boards(np.random.default_rng(2), replace(OPTIONS, tilt_deg=(0.0, 0.5), roll_deg=1.0))
    for number, pose in enumerate(flat.poses):
        parallel = Pose(np.eye(3), pose.translation)
        write_board_capture(folder / f"parallel/{number}", TARGET, flat.calibration, parallel)
    return folder


@pytest.mark.parametrize(
    ("given", "board", "code", "told"),
    [
        ("blank", "chessboard:7x5", 2, "no chessboard:7x5 was found"),
        ("two", "chessboard:7x5", 2, "there are two boards like chessboard:7x5"),
        ("good", "chessboard:6x4", 2, "but a chessboard of 7 × 5 inner corners"),
        ("good", "chessboard:8x6", 2, "no chessboard:8x6 was found"),
        ("good", "charuco:7x5", 2, "nor any markers"),
        ("good/0 good/0", "chessboard:7x5", 2, "good/0: given twice"),
        ("good/0 good/1 blank", "chessboard:7x5", 2, "expected the board in at least three captures"),
        ("good/0 good/1", "chessboard:7x5", 4, "at least three are needed"),
        ("parallel", "chessboard:7x5", 4, "Parallel boards do not determine focal lengths"),
    ],
)
def test_mistakes_are_reported(
    given: str,
    board: str,
    code: int,
    told: str,
    captures: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(captures)
    out = tmp_path / "out"
    assert main(["board", *given.split(), "--board", board, "--square", "50mm", "--out", str(out)]) == code
    assert told in capsys.readouterr().err
    assert not (out / "calibration.yaml").exists()


def test_a_view_without_a_board_is_named_and_left_out(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A wrong size of the square shows in implausible lengths."""
    monkeypatch.chdir(captures)
    arguments = ["board", "good", "blank", "two", "--board", "chessboard:7x5", "--out", str(tmp_path / "out")]
    code = main([*arguments, "--square", "5mm"])
    told = " ".join("".join(capsys.readouterr()).split())
    assert code == 0, told
    assert "blank is not used: no chessboard:7x5 was found" in told
    assert "two is not used: there are two boards" in told
    assert "That is unlikely: measure the square again" in told
