"""Folders that are no capture or are ambiguous, and wrong arguments."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.numerics import Image
from scanner.capture import open_capture
from scanner.errors import InputError
from scanner.io import read_image, write_png
from tests.support.foreign_captures import (
    CAMERA,
    ENDS,
    KNOWN,
    PAIRS,
    PROJECTOR,
    Photographer,
    bits,
    imported,
    named,
    photographer,
)

pytestmark = pytest.mark.xdist_group("importing")


def refused(capsys: pytest.CaptureFixture[str], source: Path, *arguments: object) -> str:
    """The error message, after which --out does not exist."""
    out = source.parent / "nothing"
    assert imported(source, *arguments, "--out", out) == 2
    assert not out.exists()
    error: str = capsys.readouterr().err
    assert error.startswith("scan: ")
    assert "Traceback" not in error
    return error


def test_frames_in_an_unknown_order(camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shuffled = [PAIRS[index] for index in np.random.default_rng(0).permutation(len(PAIRS))]
    error = refused(capsys, camera.write(tmp_path / "frames", shuffled, named("{}.png")))
    assert "38 frames, 0.png to 37.png; they fit no known order of frames" in error
    assert "opencv, " in error
    assert error.index("sltk") > error.index("opencv")


def test_swapped_axes_look_mirrored(camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows_first = [*bits("y", 9), *bits("x", 10), *ENDS]
    error = refused(capsys, camera.write(tmp_path / "frames", rows_first, named("{}.png")), "--from", "opencv")
    assert "mirrored" in error or "never changes" in error


def test_a_mirrored_capture_is_not_taken_for_swapped_axes(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = camera.write(tmp_path / "frames", [*PAIRS, *ENDS], named("{}.png"), lambda image: image[:, ::-1].copy())
    assert "mirrored" in refused(capsys, source)


def test_a_missing_frame_gives_a_wrong_count(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    source = folder("procam-calibration")
    (source / "graycode_11.png").unlink()
    error = refused(capsys, source, "--from", "procam-calibration")
    assert "39 frames" in error
    assert "no sequence of 39 frames" in error


def test_too_many_files_are_refused_before_reading(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "film").mkdir()
    for number in range(300):
        (tmp_path / "film" / f"{number}.png").write_bytes(b"no image")
    assert "no sequence of 300 frames" in refused(capsys, tmp_path / "film")


def test_undeterminable_values_are_asked_for(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert "give --projector and --cell" in refused(capsys, folder("phase-shifting"))
    assert "give --projector" in refused(capsys, folder("slstudio-gray, x"))


def middle(image: Image) -> Image:
    return image[150:230, 190:290].copy()


def test_an_unseen_projector_size_is_asked_for(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """If the camera sees only the middle of the picture, several projectors are possible."""
    source = camera.write(tmp_path / "frames", [*PAIRS, *ENDS], named("graycode_{:02d}.png"), middle)
    error = refused(capsys, source)
    sizes = re.findall(r"^  \d+\. opencv: projector (\d+ × \d+)", error, re.MULTILINE)
    assert sizes[:3] == ["640 × 480", "848 × 480", "854 × 480"]
    assert {"640 × 360", "800 × 480", "1280 × 720", "1600 × 900"} <= {*sizes}
    assert sizes.index("1280 × 720") < sizes.index("640 × 360")  # the more usual first, with cells of two
    assert "orders fit, choose one with --order and its number, --from or --projector" in error
    assert imported(source, *KNOWN, "--out", tmp_path / "capture", "--quiet") == 0
    assert open_capture(tmp_path / "capture").projector_size == PROJECTOR


def test_cells_of_several_pixels_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Codes of 640 × 360 are those of 1280 × 720 with cells of two, and nothing in the frames tells which."""
    camera = photographer(CAMERA, (1280, 720))
    shown = [*bits("x", 10, 2), *bits("y", 9, 2), *ENDS]
    source = camera.write(tmp_path / "frames", shown, named("{:02d}.png"))
    error = refused(capsys, source)
    sizes = re.findall(r"^  \d\. opencv: projector (\d+ × \d+)", error, re.MULTILINE)
    assert sizes == ["1280 × 720", "640 × 360", "2560 × 1440"]
    assert "1280 × 720 is usual, with cells of 2 px" in error
    assert "640 × 360 is rare" in error
    for number, chosen in enumerate([("--order", "1"), ("--projector", "1280x720")]):
        assert imported(source, *chosen, "--out", tmp_path / str(number), "--quiet") == 0
        recording = open_capture(tmp_path / str(number))
        assert (recording.projector_size, list(recording.patterns)) == ((1280, 720), shown)


def test_a_projector_without_the_codes_that_are_seen_is_refused(
    folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    error = refused(capsys, folder("opencv"), "--projector", "520x400")
    assert re.search(
        r"codes from 0 to 639 in x, .* are not those of a projector of 520 × 400; they fit 640 × 480", error
    )


def test_a_named_order_is_accepted_although_it_does_not_decode(
    folder: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`scan replay` then reports the error; the order itself is clear."""

    class Decoder:
        def __init__(self, *_: object, **__: object) -> None:
            raise InputError("something is odd about frame 3")

    monkeypatch.setattr("scanner.importing.recognition.Decoder", Decoder)
    source, word = folder("opencv"), ("--from", "opencv", *KNOWN)
    assert "looks right, but does not decode: something is odd about frame 3" in refused(capsys, source)
    assert "something is odd" in refused(capsys, source, *word[:2])
    assert imported(source, *word, "--out", tmp_path / "capture") == 0
    assert "not checked: does not decode: something is odd" in capsys.readouterr().out
    assert open_capture(tmp_path / "capture").patterns == (*PAIRS, *ENDS)


def test_a_wrong_projector_size_is_refused(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    error = refused(capsys, folder("opencv"), "--projector", "1920x1080")
    assert "decodes, but its codes from 0 to 639 in x" in error
    assert "are not those of a projector of 1920 × 1080; they fit 640 × 480 in cells of 1 px" in error


def test_a_frame_of_another_size(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    source = folder("procam-calibration")
    write_png(source / "graycode_05.png", read_image(source / "graycode_05.png")[::2])
    assert "graycode_05.png: expected an image of the kind of graycode_00.png, 459 × 384" in refused(capsys, source)


def test_a_damaged_frame(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    source = folder("procam-calibration")
    (source / "graycode_05.png").write_bytes(b"\x89PNG and no more")
    assert "graycode_05.png" in refused(capsys, source)


def test_photographs_without_patterns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "holiday").mkdir()
    noise = np.random.default_rng(3)
    for number in range(42):
        write_png(tmp_path / "holiday" / f"{number}.png", noise.integers(0, 255, (96, 128), dtype=np.uint8))
    assert "they fit no known order of frames" in refused(capsys, tmp_path / "holiday")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--from", "opencv4"), "expected one of scan, opencv, procam-calibration"),
        (("--projector", "1024"), "--projector 1024: expected a size like 1024x768"),
        (("--cell", "0"), "--cell 0: expected a number of pixels from 1 to 4096"),
    ],
)
def test_wrong_arguments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    (tmp_path / "frames").mkdir()
    assert said in refused(capsys, tmp_path / "frames", *arguments)


def test_nothing_is_overwritten(folder: Callable[[str], Path], tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "mine.txt").write_text("mine")
    assert imported(folder("procam-calibration"), "--out", tmp_path / "taken") == 2
    assert (tmp_path / "taken" / "mine.txt").read_text() == "mine"
