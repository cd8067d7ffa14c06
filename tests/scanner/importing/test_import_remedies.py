"""Frames too many, too fine or mirrored, and projectors that several sizes fit: imported, or said what helps."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.numerics import Image
from scanner.capture import open_capture
from scanner.io import read_image
from scanner.patterns import Black, Gray, Pattern, White
from tests.support.foreign_captures import (
    AXES,
    CENTRED,
    ENDS,
    PAIRS,
    PROJECTOR,
    QUARTERS,
    TURNS,
    Photographer,
    bits,
    imported,
    named,
    same,
    steps,
)

pytestmark = pytest.mark.xdist_group("importing")


def mirrored(image: Image) -> Image:
    return image[:, ::-1].copy()


def upside_down(image: Image) -> Image:
    return image[::-1].copy()


def noisy() -> Callable[[Image], Image]:
    """Add noise of its own to every frame, so that none is a copy of the one before."""
    random = np.random.default_rng(1)
    return lambda image: np.clip(image + random.normal(0, 1, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("before", "shown", "after"),
    [
        ([Black()], [*ENDS, *CENTRED], []),
        ([], [*PAIRS, *ENDS], [White()]),
        ([Black()], [*ENDS, *PAIRS], [White()]),
        ([Black(), White()], [*TURNS, Gray("x", 9, 10)], []),
    ],
    ids=["ambient light first", "a texture last", "both", "two first, by turns"],
)
def test_surplus_frames_at_either_end_are_left_out(
    camera: Photographer, tmp_path: Path, before: list[Pattern], shown: list[Pattern], after: list[Pattern]
) -> None:
    source = camera.write(tmp_path / "frames", [*before, *shown, *after], named("{:02d}.png"), noisy())
    assert imported(source, "--out", tmp_path / "out", "--quiet") == 0
    recording = open_capture(tmp_path / "out")
    kept = len(recording.patterns)
    assert recording.projector_size == PROJECTOR
    assert list(recording.patterns)[-len(shown) :] == shown[-kept:]
    assert kept >= len(shown)


@pytest.mark.parametrize("late", [3, 19, 24])
def test_a_frame_that_is_the_one_before_is_named(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str], late: int
) -> None:
    """An inverted bit that shows the bit: coarse, or fine; and a bit that shows the inverse of a coarser one."""
    patterns = [*PAIRS, *ENDS]
    source = camera.write(tmp_path / "frames", patterns, named("{:02d}.png"), noisy())
    shutil.copyfile(source / f"{late - 1:02d}.png", source / f"{late:02d}.png")
    assert imported(source, "--out", tmp_path / "out") == 0
    assert f"{late:02d}.png is the frame before it, bit for bit: the projector was late" in " ".join(
        capsys.readouterr().out.split()
    )
    assert list(open_capture(tmp_path / "out").patterns) == patterns


@pytest.mark.parametrize("count", [3, 4])
def test_bits_that_the_camera_does_not_resolve_are_left_out_and_named(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str], count: int
) -> None:
    """Twelve bits of 640 columns: quarters of a pixel are half lit everywhere, as are cells of one and two."""
    source = camera.write(tmp_path / "frames", [*PAIRS, *ENDS], named("{:02d}.png"))
    for number, pattern in enumerate(PAIRS):
        if isinstance(pattern, Gray) and pattern.bit >= pattern.bits - count:
            half = (camera.take(White()).astype(np.float64) + camera.take(Black())) / 2
            assert cv2.imwrite(str(source / f"{number:02d}.png"), np.rint(half).astype(np.uint8))
    assert imported(source, "--out", tmp_path / "out") == 0
    said = " ".join(capsys.readouterr().out.split())
    numbers = ", ".join(str(bit) for bit in range(10 - count, 10))
    assert f"without bit {numbers} of x and bit" in said
    assert "too fine for the lenses" in said
    recording = open_capture(tmp_path / "out")
    assert recording.projector_size == PROJECTOR
    assert {p.cell for p in recording.patterns if isinstance(p, Gray)} == {2**count}
    assert len(recording.patterns) == len(PAIRS) + 2 - 4 * count


@pytest.mark.parametrize(("flip", "change"), [("x", mirrored), ("y", upside_down)])
def test_mirrored_frames_are_named_and_mirrored_back(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str], flip: str, change: object
) -> None:
    assert callable(change)
    patterns = [*PAIRS, *ENDS]
    source = camera.write(tmp_path / "frames", patterns, named("{:02d}.png"), change)
    assert imported(source, "--out", tmp_path / "nothing") == 2
    error = capsys.readouterr().err
    assert f"opencv, procam-calibration: fits, but {flip} runs backwards, as in a mirror" in error
    assert f"give --flip {flip}" in error
    assert "rear projection: switch that off" in error
    assert "no sequence" not in error, "only the closest order is shown"
    assert imported(source, "--flip", flip, "--out", tmp_path / "out", "--quiet") == 0
    recording = open_capture(tmp_path / "out")
    assert list(recording.patterns) == patterns
    for file, pattern in zip(recording.files, patterns, strict=True):
        assert np.array_equal(read_image(tmp_path / "out" / file), camera.take(pattern))


def test_white_and_black_are_no_bits_of_a_mirrored_code(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bit that is always 1 before the others mirrors the code, so that mirrored frames decode."""
    patterns = [*ENDS, *bits("x", 10, inverses=False), *bits("y", 9, inverses=False)]
    source = camera.write(tmp_path / "frames", patterns, named("{:02d}.png"), mirrored)
    assert imported(source) == 2
    assert "give --flip x" in capsys.readouterr().err
    assert imported(source, "--flip", "x", "--out", tmp_path / "out", "--quiet") == 0
    assert list(open_capture(tmp_path / "out").patterns) == patterns


def test_a_projector_that_the_codes_do_not_fit_is_refused(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = camera.write(tmp_path / "frames", [*ENDS, *CENTRED], named("{:02d}.png"))
    assert imported(source, "--projector", "848x480") == 2
    error = capsys.readouterr().err
    assert re.search(r"codes from 96 to 41\d in x, .* are not those of a projector of 848 × 480", error)
    assert "they fit 640 × 480" in error


def test_cells_of_two_pixels_are_recognised_by_the_ends_of_the_picture(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No projector has 320 × 240 pixels; with its ends out of view, several have them in cells."""
    patterns = [*bits("x", 9, 2), *bits("y", 8, 2), *ENDS]
    source = camera.write(tmp_path / "frames", patterns, named("{:02d}.png"))
    assert imported(source, "--out", tmp_path / "out", "--quiet") == 0
    recording = open_capture(tmp_path / "out")
    assert (list(recording.patterns), recording.projector_size) == (patterns, PROJECTOR)
    unseen = camera.write(
        tmp_path / "middle", patterns, named("{:02d}.png"), lambda image: image[150:230, 190:290].copy()
    )
    assert imported(unseen, "--out", tmp_path / "nothing") == 2
    error = capsys.readouterr().err
    assert "opencv: projector 640 × 480; x, then y; cells of 2 px; coarsest bit first" in error
    number = re.findall(r"(\d)\. opencv: projector 640 × 480", error)[0]
    assert imported(unseen, "--order", number, "--out", tmp_path / "chosen", "--quiet") == 0
    assert list(open_capture(tmp_path / "chosen").patterns) == patterns


def test_what_lacks_only_a_number_is_the_only_reason(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half periods of 7.5 px are fringes with a code, whatever their number."""
    patterns = [
        p
        for axis, length in AXES
        for p in (*steps(axis, length / 32, QUARTERS), *bits(axis, 6, length / 64, inverses=False))
    ]
    source = camera.write(tmp_path / "frames", patterns, named("{:02d}.png"))
    assert imported(source) == 2
    reasons = capsys.readouterr().err.strip().splitlines()[1:]
    assert [reason.split(":")[0].strip() for reason in reasons] == ["gray-fringes"]
    assert reasons[0].endswith("give --projector and --periods")
    assert imported(source, "--projector", "640x480", "--periods", "32", "--out", tmp_path / "out", "--quiet") == 0
    assert all(map(same, open_capture(tmp_path / "out").patterns, patterns))


def test_oblong_pixels_are_told_in_square_ones(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = camera.write(tmp_path / "frames", [*PAIRS, *ENDS], named("{:02d}.png"))
    assert imported(source, "--pixel-aspect", "0.5", "--out", tmp_path / "out") == 0
    assert "In square pixels: projector 1280 × 480" in " ".join(capsys.readouterr().out.split())
    recording = open_capture(tmp_path / "out")
    assert recording.projector_size == (2 * PROJECTOR[0], PROJECTOR[1])
    assert {(p.axis, p.cell) for p in recording.patterns if isinstance(p, Gray)} == {("x", 2), ("y", 1)}
    assert imported(source, "--pixel-aspect", "0") == 2
    assert "expected height over width, 0.2 to 5, as in 0.5" in capsys.readouterr().err
