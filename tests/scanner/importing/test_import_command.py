"""Folders as other programs leave them become capture folders, whose sequence is the one that was shown."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from calib.numerics import Image
from scanner.capture.recording import open_capture
from scanner.commands.main import main
from scanner.decoding.decoder import Decoder
from scanner.errors import InputError
from scanner.io.image_file import read_image
from scanner.io.png import write_png
from scanner.patterns.pattern import Axis, Black, Gray, Pattern, Phase, White
from tests.support.foreign_captures import ENDS, Photographer, bits, deep, in_colour, named, photographer, steps
from tests.support.places import REAL_CAPTURES

pytestmark = pytest.mark.xdist_group("importing")

# The smallest projector that is sold, so that its size is recognised.
CAMERA, PROJECTOR = (459, 384), (640, 360)
AXES: tuple[tuple[Axis, int], ...] = (("x", 640), ("y", 360))
PAIRS = [*bits("x", 10), *bits("y", 9)]
CENTRED = [*bits("x", 9, 2, 192), *bits("y", 9, 1, 76)]  # (1024 − 640) / 2 and (512 − 360) / 2 pixels before the first
THIRDS, BACKWARDS = (-1 / 3, 0.0, 1 / 3), (0.0, -1 / 3, -2 / 3)
FRINGES = [shown for axis, _ in AXES for period in (80 / 3, 40.0) for shown in steps(axis, period, THIRDS)]
LONG_AND_SHORT = {
    axis: [*steps(axis, length / 16, BACKWARDS), *steps(axis, float(length), BACKWARDS)] for axis, length in AXES
}
NINE_STEPS = [
    shown
    for axis, length in AXES
    for shown in (*steps(axis, length / 8, [-step / 9 for step in range(9)]), *steps(axis, float(length), BACKWARDS))
]
COARSE = {"x": bits("x", 10, inverses=False), "y": bits("y", 6, 8, inverses=False)}
KNOWN = ("--projector", "640x360")


def sltk() -> Iterator[str]:
    for number in range(40):
        axis, place, inverted = number // 20, 9 - number % 20 // 2, number % 2
        yield f"{1481302049.5 + 2 * number}_[{axis:02d}-{place:02d}-{inverted:02d}_{number:02d}]_img.jpg"


@dataclass(frozen=True)
class Foreign:
    """`patterns` in the order of `names`; the `arguments` that are needed; what the camera's files are like."""

    layout: str
    patterns: list[Pattern]
    names: Iterator[str]
    arguments: tuple[str, ...] = ()
    change: Callable[[Image], Image] = np.asarray


FOREIGN = {
    "opencv": Foreign("opencv", [*PAIRS, *ENDS], named("pattern_cam1_im{}.png", 1)),
    "opencv, black and white first": Foreign("opencv", [Black(), White(), *PAIRS], named("{}.tif"), change=deep),
    "opencv, without": Foreign("opencv", PAIRS, named("IMG_{:05d}.JPG", 997), change=in_colour),
    "opencv, white and black apart": Foreign(
        "opencv", [*PAIRS, *ENDS], iter([*(f"p{n}.png" for n in range(38)), "white.png", "black.png"])
    ),
    "opencv, of two pixels": Foreign(
        "opencv", [*bits("x", 9, 2), *bits("y", 8, 2), *ENDS], named("{}.png"), ("--cell", "2")
    ),
    "procam-calibration": Foreign("procam-calibration", [*PAIRS, *ENDS], named("graycode_{:02d}.png")),
    "phase-shifting": Foreign(
        "phase-shifting",
        [*FRINGES, *bits("x", 4, 40), *bits("y", 4, 40), *ENDS],
        named("pat{:02d}.png"),
        (*KNOWN, "--cell", "40"),
    ),
    "moreno-taubin": Foreign("moreno-taubin", [*ENDS, *CENTRED], named("cam_{:02d}.png", 1)),
    "3dunderworld": Foreign("3dunderworld", [*ENDS, *PAIRS], named("{:04d}.jpg")),
    "sltk": Foreign("sltk", [*bits("x", 10), *bits("y", 10)], sltk()),
    "sltk, renamed": Foreign("sltk", [*bits("x", 10), *bits("y", 10)], named("{}.png")),
    "slstudio-gray": Foreign("slstudio-gray", [*ENDS, *COARSE["x"], *COARSE["y"]], named("frame {}.bmp")),
    "slstudio-gray, x": Foreign("slstudio-gray", [*ENDS, *COARSE["x"]], named("{}.bmp"), KNOWN),
    "slstudio-2x3": Foreign("slstudio-2x3", [*LONG_AND_SHORT["x"], *LONG_AND_SHORT["y"]], named("{}.png"), KNOWN),
    "slstudio-2x3, y": Foreign("slstudio-2x3", LONG_AND_SHORT["y"], named("{}.png"), KNOWN),
    "slstudio-nstep": Foreign("slstudio-nstep", NINE_STEPS, named("{}.png"), KNOWN),
}


@pytest.fixture(scope="module")
def camera() -> Photographer:
    return photographer(CAMERA, PROJECTOR)


@pytest.fixture(scope="module")
def folder(camera: Photographer, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The frames of one of FOREIGN, and copies of them to spoil."""
    kept = {}

    def of(name: str) -> Path:
        if name not in kept:
            case, place = FOREIGN[name], tmp_path_factory.mktemp("foreign") / "frames"
            kept[name] = camera.write(place, case.patterns, case.names, case.change)
        copy: Path = tmp_path_factory.mktemp("copy") / "frames"
        return Path(shutil.copytree(kept[name], copy))

    return of


def imported(source: Path, *arguments: object) -> int:
    return main(["import", str(source), *map(str, arguments)])


def same(one: Pattern, other: Pattern) -> bool:
    """Periods and shifts are as good as rounding."""
    if isinstance(one, Phase) and isinstance(other, Phase):
        return one.axis == other.axis and np.allclose((one.period, one.shift), (other.period, other.shift), atol=1e-9)
    return one == other


@pytest.mark.parametrize("told", [True, False], ids=["from", "any"])
@pytest.mark.parametrize("name", FOREIGN)
def test_a_foreign_folder_becomes_a_capture(
    folder: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, told: bool
) -> None:
    case, out = FOREIGN[name], tmp_path / "capture"
    source = folder(name)
    before = {path.name: path.read_bytes() for path in source.iterdir()}
    chosen = ("--from", case.layout) if told else ()
    assert imported(source, *chosen, *case.arguments, "--out", out) == 0, capsys.readouterr().err
    recording = open_capture(out)
    assert (recording.projector_size, recording.camera_size) == (PROJECTOR, CAMERA)
    assert len(recording.patterns) == len(case.patterns)
    assert all(map(same, recording.patterns, case.patterns))
    assert {path.name: path.read_bytes() for path in source.iterdir()} == before
    assert {path.name: path.read_bytes() for path in (out / "frames").iterdir()} == before
    if not told:
        assert f"{case.layout}" in capsys.readouterr().out


def turned(image: Image, turns: int) -> Image:
    for _ in range(turns):
        image = image.T[::-1].copy()
    return image


def inverses_of(axis: Axis, number: int) -> list[Pattern]:
    return bits(axis, number)[1::2]


X, Y = bits("x", 10, inverses=False), bits("y", 9, inverses=False)
NOT_X, NOT_Y = inverses_of("x", 10), inverses_of("y", 9)
FINE_FIRST = [
    p for of_axis in (PAIRS[:20], PAIRS[20:]) for bit in range(len(of_axis) - 2, -1, -2) for p in of_axis[bit : bit + 2]
]


@pytest.mark.parametrize(
    ("layout", "patterns"),
    [
        ("opencv", [*PAIRS, White()]),
        ("3dunderworld", [White(), *PAIRS]),
        ("moreno-taubin", [Black(), *CENTRED]),
        ("gray", [*bits("y", 9), *bits("x", 10), *ENDS]),
        ("gray", [*X, *NOT_X, *Y, *NOT_Y, *ENDS]),
        ("gray", [*ENDS, *X, *Y, *NOT_X, *NOT_Y]),
        ("gray", [*X, *Y]),
        ("gray", FINE_FIRST),
    ],
    ids=[
        "no black",
        "only white first",
        "no white",
        "y first",
        "inverses of axes",
        "all inverses",
        "none",
        "fine first",
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


@pytest.mark.parametrize(("twice", "name"), [(0, "1.png"), (17, "18.png"), (39, "40.png")])
def test_a_frame_that_was_taken_twice_is_left_out(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str], twice: int, name: str
) -> None:
    shown = [*PAIRS, *ENDS]
    source = camera.write(tmp_path / "frames", [*shown[: twice + 1], *shown[twice:]], named("{}.png"))
    assert imported(source, "--out", tmp_path / "capture") == 0, capsys.readouterr().err
    recording = open_capture(tmp_path / "capture")
    assert (recording.patterns, recording.projector_size) == (tuple(shown), PROJECTOR)
    assert f"left out: {name}" in " ".join(capsys.readouterr().out.split())
    assert not (tmp_path / "capture" / "frames" / name).exists()


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_camera_on_its_side(camera: Photographer, tmp_path: Path, turns: int) -> None:
    source = camera.write(
        tmp_path / "frames",
        [*PAIRS, *ENDS],
        named("{}.png"),
        lambda image: turned(image, turns),
    )
    assert imported(source, "--out", tmp_path / "capture", "--quiet") == 0
    assert open_capture(tmp_path / "capture").patterns == (*PAIRS, *ENDS)


def test_a_mirrored_capture_is_none_of_y_before_x(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = camera.write(tmp_path / "frames", [*PAIRS, *ENDS], named("{}.png"), lambda image: image[:, ::-1].copy())
    assert "mirrored" in refused(capsys, source)


def test_what_is_imported_decodes_to_the_truth(
    camera: Photographer, folder: Callable[[str], Path], tmp_path: Path
) -> None:
    """Counted from the middle, in cells of two pixels and of one: the offsets are right, too."""
    assert imported(folder("moreno-taubin"), "--out", tmp_path / "capture", "--quiet") == 0
    stream = open_capture(tmp_path / "capture").stream()
    decoder = Decoder(stream.patterns, stream.projector_size)
    for _, frame in stream.frames:
        decoder.add(frame.image)
    matches = decoder.finish().matches
    column, row = np.rint(matches.camera_px).astype(int).T
    error_px = np.linalg.norm(matches.projector_px - camera.room.ground_truth().projector_px[row, column], axis=1)
    assert len(matches) > 10_000
    assert 0.1 < np.nanmedian(error_px) < 0.8


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
    [("320 360\n\n# width height\n", 0), ("300 360\n", 2), ("not ours", 0)],
    ids=["told", "contradicted", "no numbers"],
)
def test_projector_info_is_read(folder: Callable[[str], Path], tmp_path: Path, codes: str, code: int) -> None:
    source = folder("moreno-taubin")
    (source / "projector_info.txt").write_text(codes)
    assert imported(source, "--from", "moreno-taubin", "--out", tmp_path / "capture", "--quiet") == code
    assert code or open_capture(tmp_path / "capture").projector_size == PROJECTOR


def test_config_xml_tells_projector_and_step(folder: Callable[[str], Path], tmp_path: Path) -> None:
    source = folder("phase-shifting")
    text = "<disp_width>640</disp_width><disp_height>360</disp_height><step>80</step>"
    (source / "config.xml").write_text(f'<?xml version="1.0"?>\n<opencv_storage>{text}</opencv_storage>\n')
    assert imported(source, "--out", tmp_path / "capture", "--quiet") == 0
    assert all(map(same, open_capture(tmp_path / "capture").patterns, FOREIGN["phase-shifting"].patterns))


def refused(capsys: pytest.CaptureFixture[str], source: Path, *arguments: object) -> str:
    """The one message, after which there is nothing at --out."""
    out = source.parent / "nothing"
    assert imported(source, *arguments, "--out", out) == 2
    assert not out.exists()
    error: str = capsys.readouterr().err
    assert error.startswith("scan: ")
    assert "Traceback" not in error
    return error


def test_frames_that_were_shown_in_no_known_order(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shuffled = [PAIRS[index] for index in np.random.default_rng(0).permutation(len(PAIRS))]
    error = refused(capsys, camera.write(tmp_path / "frames", shuffled, named("{}.png")))
    assert "38 frames, 0.png to 37.png; in no order that is known they are a capture" in error
    assert "opencv:" in error


def test_rows_before_columns_are_mirrored(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows_first = [*bits("y", 9), *bits("x", 10), *ENDS]
    error = refused(capsys, camera.write(tmp_path / "frames", rows_first, named("{}.png")), "--from", "opencv")
    assert "mirrored" in error or "never changes" in error


def test_a_missing_frame_is_a_wrong_number(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    source = folder("procam-calibration")
    (source / "graycode_11.png").unlink()
    error = refused(capsys, source, "--from", "procam-calibration")
    assert "39 frames" in error
    assert "no sequence of 39 frames" in error


def test_what_is_too_many_is_not_even_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "film").mkdir()
    for number in range(300):
        (tmp_path / "film" / f"{number}.png").write_bytes(b"no image")
    assert "no sequence of 300 frames" in refused(capsys, tmp_path / "film")


def test_what_frames_cannot_tell_is_asked_for(
    folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "give --projector and --cell" in refused(capsys, folder("phase-shifting"))
    assert "give --projector" in refused(capsys, folder("slstudio-gray, x"))


def middle(image: Image) -> Image:
    return image[150:230, 190:290].copy()


def test_a_size_that_was_not_seen_is_asked_for(
    camera: Photographer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where the camera sees the middle of the picture only, several projectors may have shown it."""
    source = camera.write(tmp_path / "frames", [*PAIRS, *ENDS], named("graycode_{:02d}.png"), middle)
    error = refused(capsys, source)
    assert "the projector's size is not clear, 640 × 360, or 640 × 480" in error
    assert "give --projector" in error
    assert imported(source, *KNOWN, "--out", tmp_path / "capture", "--quiet") == 0
    assert open_capture(tmp_path / "capture").projector_size == PROJECTOR


def test_what_looks_right_and_does_not_decode_is_taken_at_ones_word(
    folder: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`scan replay` will say what is wrong with them; but whose they are is clear."""

    class Decoder:
        def __init__(self, *_: object) -> None:
            raise InputError("something is odd about frame 3")

    monkeypatch.setattr("scanner.importing.recognition.Decoder", Decoder)
    source, word = folder("opencv"), ("--from", "opencv", *KNOWN)
    assert "looks right, but does not decode: something is odd about frame 3" in refused(capsys, source)
    assert "something is odd" in refused(capsys, source, *word[:2])
    assert imported(source, *word, "--out", tmp_path / "capture") == 0
    assert "not checked: does not decode: something is odd" in capsys.readouterr().out
    assert open_capture(tmp_path / "capture").patterns == (*PAIRS, *ENDS)


def test_a_wrong_projector_is_not_believed(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    error = refused(capsys, folder("opencv"), "--projector", "1920x1080")
    assert "no sequence of 40 frames for a projector of 1920 × 1080" in error


def test_a_frame_of_another_size(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    source = folder("procam-calibration")
    write_png(source / "graycode_05.png", read_image(source / "graycode_05.png")[::2])
    assert "graycode_05.png: expected an image of the kind of graycode_00.png, 459 × 384" in refused(capsys, source)


def test_a_damaged_frame(folder: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    source = folder("procam-calibration")
    (source / "graycode_05.png").write_bytes(b"\x89PNG and no more")
    assert "graycode_05.png" in refused(capsys, source)


def test_photographs_of_anything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "holiday").mkdir()
    noise = np.random.default_rng(3)
    for number in range(42):
        write_png(tmp_path / "holiday" / f"{number}.png", noise.integers(0, 255, (96, 128), dtype=np.uint8))
    assert "in no order that is known" in refused(capsys, tmp_path / "holiday")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--from", "opencv4"), "expected one of opencv, procam-calibration"),
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


def test_without_out_it_only_says_what_it_is(
    folder: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(folder("3dunderworld")) == 0
    said = capsys.readouterr().out
    assert "projector 640 × 360" in said
    rows = [line.split() for line in said.splitlines() if line.startswith(" ")]
    lines = {row[0]: row[1] for row in rows if len(row) > 2}
    assert lines["3dunderworld"] == "yes"
    assert lines["phase-shifting"] == lines["slstudio-nstep"] == "no"


@pytest.mark.skipif(not REAL_CAPTURES.is_dir(), reason="the real captures are not here")
@pytest.mark.parametrize("number", range(5))
def test_real_captures_are_imported_as_they_are_listed(tmp_path: Path, number: int) -> None:
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


def test_gray_bits_are_those_of_the_sources() -> None:
    """The orders above, against the sources' own loops: bit k of n xor n / 2, the most significant first."""
    assert [(p.bit, p.inverted) for p in PAIRS[:3] if isinstance(p, Gray)] == [(0, False), (0, True), (1, False)]
    n = np.arange(640.0)
    for pattern in PAIRS[:20:2]:
        assert isinstance(pattern, Gray)
        shown = (n.astype(int) ^ n.astype(int) >> 1) >> 9 - pattern.bit & 1
        assert np.array_equal(pattern.brightness(n, n), shown)
