"""Folders of other programs become captures with the sequence that was shown."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.geometry import Matches
from calib.numerics import Image
from scanner.capture import open_capture
from scanner.decoding import Decoder
from scanner.patterns import Axis, Black, Gray, Pattern, White
from tests.support.foreign_captures import (
    CAMERA,
    CENTRED,
    ENDS,
    FOREIGN,
    PAIRS,
    PROJECTOR,
    Photographer,
    bits,
    imported,
    named,
    same,
    steps,
)
from tests.support.places import REAL_CAPTURES

pytestmark = pytest.mark.xdist_group("importing")


@pytest.mark.parametrize("name", FOREIGN)
def test_a_foreign_folder_becomes_a_capture(
    folder: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    case, out = FOREIGN[name], tmp_path / "capture"
    source = folder(name)
    before = {path.name: path.read_bytes() for path in source.iterdir()}
    assert imported(source, *case.arguments, "--out", out) == 0, capsys.readouterr().err
    recording = open_capture(out)
    assert (recording.projector_size, recording.camera_size) == (PROJECTOR, CAMERA)
    assert len(recording.patterns) == len(case.patterns)
    assert all(map(same, recording.patterns, case.patterns))
    assert {path.name: path.read_bytes() for path in source.iterdir()} == before
    assert {path.name: path.read_bytes() for path in (out / "frames").iterdir()} == before
    assert f"{case.layout}" in capsys.readouterr().out


def turned(image: Image, turns: int) -> Image:
    for _ in range(turns):
        image = image.T[::-1].copy()
    return image


def inverses_of(axis: Axis, number: int) -> list[Pattern]:
    return bits(axis, number)[1::2]


X, Y = bits("x", 10, inverses=False), bits("y", 9, inverses=False)
NOT_X, NOT_Y = inverses_of("x", 10), inverses_of("y", 9)
Y_AND_FINE_FIRST = [
    p for of_axis in (PAIRS[20:], PAIRS[:20]) for bit in range(len(of_axis) - 2, -1, -2) for p in of_axis[bit : bit + 2]
]


@pytest.mark.parametrize("blur_px", [0.9, 1.0])
@pytest.mark.parametrize("patterns", [[*ENDS, *X, *Y], [*ENDS, *X[::-1], *Y[::-1]]], ids=["usual", "finest first"])
def test_photographs_are_recognised_whose_tone_curve_brightens_blurred_stripes(
    camera: Photographer, tmp_path: Path, patterns: list[Pattern], blur_px: float
) -> None:
    """The finest bits are left out where the others decode only without them: at 1 px, which of both depends on how
    OpenCV rounds on a processor.
    """
    brighter = np.rint(255 * np.linspace(0, 1, 256) ** (1 / 2.2)).astype(np.uint8)

    def developed(image: Image) -> Image:
        return brighter[cv2.GaussianBlur(image, (0, 0), blur_px)]

    source = camera.write(tmp_path / "frames", patterns, named("{}.png"), developed)
    assert imported(source, "--projector", "640x480", "--out", tmp_path / "out") == 0
    possible = [patterns] if blur_px < 1 else [patterns, without_finest(patterns, 1)]
    assert list(open_capture(tmp_path / "out").patterns) in possible


def without_finest(patterns: list[Pattern], count: int) -> list[Pattern]:
    """Return the frames of the coarser bits, with longer cells."""
    return [
        replace(p, bits=p.bits - count, cell=p.cell * 2**count) if isinstance(p, Gray) else p
        for p in patterns
        if not isinstance(p, Gray) or p.bit < p.bits - count
    ]


@pytest.mark.parametrize(
    ("layout", "patterns"),
    [
        ("opencv", [*PAIRS, White()]),
        ("3dunderworld", [White(), *PAIRS]),
        ("moreno-taubin", [Black(), *CENTRED]),
        ("gray", [*X, *NOT_X, *Y, *NOT_Y, *ENDS]),
        ("gray", [*ENDS, *X, *Y, *NOT_X, *NOT_Y]),
        ("gray", [*X, *Y]),
        ("gray", Y_AND_FINE_FIRST),
    ],
    ids=[
        "no black",
        "only white first",
        "no white",
        "inverses of axes",
        "all inverses",
        "none",
        "y and fine bits first",
    ],
)
def test_less_usual_orders(
    camera: Photographer,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    layout: str,
    patterns: list[Pattern],
) -> None:
    source = camera.write(tmp_path / "frames", patterns, named("{}.png"))
    assert imported(source, "--out", tmp_path / "capture") == 0, capsys.readouterr().err
    recording = open_capture(tmp_path / "capture")
    assert (recording.patterns, recording.projector_size) == (tuple(patterns), PROJECTOR)
    assert any(line.split()[:2] == [layout, "yes"] for line in capsys.readouterr().out.splitlines() if line.strip())


@pytest.mark.parametrize(("twice", "name"), [(0, "1.png"), (39, "40.png")])
def test_a_duplicate_frame_is_left_out(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str], twice: int, name: str
) -> None:
    shown = [*PAIRS, *ENDS]
    source = camera.write(tmp_path / "frames", [*shown[: twice + 1], *shown[twice:]], named("{}.png"))
    assert imported(source, "--out", tmp_path / "capture") == 0, capsys.readouterr().err
    recording = open_capture(tmp_path / "capture")
    assert (recording.patterns, recording.projector_size) == (tuple(shown), PROJECTOR)
    assert f"left out: {name}" in " ".join(capsys.readouterr().out.split())
    assert not (tmp_path / "capture" / "frames" / name).exists()


def test_frames_of_a_covered_lens_are_refused(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = camera.write(tmp_path / "frames", [*PAIRS, *ENDS], named("{}.png"), lambda image: 0 * image)
    assert imported(source, "--out", tmp_path / "capture") == 2
    assert "it has no sequence of" in capsys.readouterr().err
    assert not (tmp_path / "capture").exists()


@pytest.mark.parametrize("turns", [1, 2])
def test_a_camera_on_its_side(camera: Photographer, tmp_path: Path, turns: int) -> None:
    source = camera.write(
        tmp_path / "frames",
        [*PAIRS, *ENDS],
        named("{}.png"),
        lambda image: turned(image, turns),
    )
    assert imported(source, "--out", tmp_path / "capture", "--quiet") == 0
    assert open_capture(tmp_path / "capture").patterns == (*PAIRS, *ENDS)


def decoded(capture: Path) -> Matches:
    stream = open_capture(capture).stream()
    decoder = Decoder(stream.patterns, stream.projector_size)
    for _, frame in stream.frames:
        decoder.add(frame.image)
    return decoder.finish().matches


def test_imported_captures_decode_to_the_truth(
    camera: Photographer, folder: Callable[[str], Path], tmp_path: Path
) -> None:
    """Codes counted from the middle, in cells of one or two pixels: offsets are right, too."""
    assert imported(folder("moreno-taubin"), "--out", tmp_path / "capture", "--quiet") == 0
    matches = decoded(tmp_path / "capture")
    column, row = np.rint(matches.camera_px).astype(int).T
    error_px = np.linalg.norm(matches.projector_px - camera.room.ground_truth().projector_px[row, column], axis=1)
    assert len(matches) > 10_000
    assert 0.01 < np.nanmedian(error_px) < 0.3


@pytest.mark.parametrize(
    ("periods", "names"), [("59,64,71", "obey one epipolar geometry"), ("59", "no sequence"), ("3;4", "as in")]
)
def test_periods_that_contradict_the_frames_are_refused(
    folder: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], periods: str, names: str
) -> None:
    source = folder("heterodyne")
    chosen = ("--from", "heterodyne", "--projector", "640x480", "--periods", periods)
    assert imported(source, *chosen, "--out", tmp_path / "capture") == 2
    assert names in capsys.readouterr().err
    assert not (tmp_path / "capture").exists()


def test_the_origin_of_two_close_periods_must_be_given(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    patterns = [p for count in (20, 21) for p in steps("x", 640 / count, (0.25, 0.0, -0.25, -0.5))]
    source = camera.write(tmp_path / "frames", patterns, named("{}.png"))
    chosen = ("--from", "heterodyne", "--projector", "640x480", "--periods", "20,21")
    assert imported(source, *chosen) == 2
    (number,) = re.findall(r"(\d)\. heterodyne: .*shifted from 0.25 cycles back", capsys.readouterr().err)
    assert imported(source, *chosen, "--order", number, "--out", tmp_path / "capture", "--quiet") == 0
    assert all(map(same, open_capture(tmp_path / "capture").patterns, patterns))


def test_fringes_of_close_periods_decode_to_the_truth(
    camera: Photographer, folder: Callable[[str], Path], tmp_path: Path
) -> None:
    """An origin a quarter of a cycle off would shift each coordinate by 2 px."""
    source, chosen = folder("heterodyne"), FOREIGN["heterodyne"].arguments
    assert imported(source, *chosen, "--out", tmp_path / "capture", "--quiet") == 0
    matches = decoded(tmp_path / "capture")
    column, row = np.rint(matches.camera_px).astype(int).T
    error_px = np.linalg.norm(matches.projector_px - camera.room.ground_truth().projector_px[row, column], axis=1)
    assert len(matches) > 10_000
    assert 0.005 < np.nanmedian(error_px) < 0.1


def test_missing_numbers_and_sub_folders_do_not_matter(folder: Callable[[str], Path], tmp_path: Path) -> None:
    source, scattered = folder("3dunderworld"), tmp_path / "data" / "left" / "dataset1"
    scattered.mkdir(parents=True)
    for number, path in enumerate(sorted(source.iterdir())):
        path.rename(scattered / f"{3 * number + 7}.jpg")
    (scattered.parent / "readme.txt").touch()
    assert imported(scattered.parent, "--from", "3dunderworld", "--out", tmp_path / "capture", "--quiet") == 0
    assert open_capture(tmp_path / "capture").patterns == tuple(FOREIGN["3dunderworld"].patterns)


@pytest.mark.parametrize(
    ("codes", "code"),
    [("320 480\n\n# width height\n", 0), ("300 480\n", 2), ("not ours", 0)],
    ids=["told", "contradicted", "no numbers"],
)
def test_projector_info_is_read(folder: Callable[[str], Path], tmp_path: Path, codes: str, code: int) -> None:
    source = folder("moreno-taubin")
    (source / "projector_info.txt").write_text(codes)
    assert imported(source, "--from", "moreno-taubin", "--out", tmp_path / "capture", "--quiet") == code
    assert code or open_capture(tmp_path / "capture").projector_size == PROJECTOR


def test_config_xml_tells_projector_and_step(folder: Callable[[str], Path], tmp_path: Path) -> None:
    source = folder("phase-shifting")
    text = "<disp_width>640</disp_width><disp_height>480</disp_height><step>80</step>"
    (source / "config.xml").write_text(f'<?xml version="1.0"?>\n<opencv_storage>{text}</opencv_storage>\n')
    assert imported(source, "--out", tmp_path / "capture", "--quiet") == 0
    assert all(map(same, open_capture(tmp_path / "capture").patterns, FOREIGN["phase-shifting"].patterns))


def test_without_out_the_order_is_only_reported(
    folder: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(folder("3dunderworld")) == 0
    said = capsys.readouterr().out
    assert "projector 640 × 480" in said
    rows = [line.split() for line in said.splitlines() if line.startswith(" ")]
    lines = {row[0]: row[1] for row in rows if len(row) > 2}
    assert lines["3dunderworld"] == "yes"
    assert lines["phase-shifting"] == lines["slstudio-nstep"] == "no"


@pytest.mark.skipif(not REAL_CAPTURES.is_dir(), reason="the real captures are not here")
@pytest.mark.parametrize("number", [4])
def test_real_captures_are_imported_with_their_known_sequence(tmp_path: Path, number: int) -> None:
    source = REAL_CAPTURES / "procam-calibration" / f"capture_{number}"
    if not source.is_dir():
        pytest.skip(f"{source} is not here")
    assert imported(source, "--from", "procam-calibration", "--out", tmp_path / "capture", "--quiet") == 0
    found, listed = open_capture(tmp_path / "capture"), open_capture(source)
    assert (found.patterns, found.projector_size, found.camera_size) == (
        listed.patterns,
        listed.projector_size,
        listed.camera_size,
    )


def test_gray_bits_match_the_original_programs() -> None:
    """The orders above match the sources' loops: bit k of n xor n / 2, most significant first."""
    assert [(p.bit, p.inverted) for p in PAIRS[:3] if isinstance(p, Gray)] == [(0, False), (0, True), (1, False)]
    n = np.arange(640.0)
    for pattern in PAIRS[:20:2]:
        assert isinstance(pattern, Gray)
        shown = (n.astype(int) ^ n.astype(int) >> 1) >> 9 - pattern.bit & 1
        assert np.array_equal(pattern.brightness(n, n), shown)
