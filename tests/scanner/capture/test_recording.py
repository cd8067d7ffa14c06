import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from errno import ENOSPC
from itertools import count, islice
from pathlib import Path
from types import FrameType
from typing import Any

import cv2
import numpy as np
import pytest

from hw.errors import DeviceError
from hw.rig import Frame
from scanner.capture import recorder
from scanner.capture.damaged_listing import MISSING_FILES
from scanner.capture.recorder import record
from scanner.capture.recording import open_capture
from scanner.capture.stream import Stream
from scanner.errors import InputError
from scanner.io import image_file as images
from scanner.io import write_png
from scanner.patterns import Gray, White, draw
from tests.support.small_capture import PATTERNS, SIZE, read_listing, write_capture, write_listing


def read_all(folder: Path) -> list[np.ndarray]:
    return [frame.image for _, frame in open_capture(folder).stream().frames]


def stream_of(frames: Iterator[Frame], count: int = len(PATTERNS), **metadata: object) -> Stream:
    return Stream(PATTERNS[:count], SIZE, SIZE, zip(PATTERNS, frames, strict=False), metadata)


def photographs() -> Iterator[Frame]:
    for index, pattern in enumerate(PATTERNS):
        yield Frame(draw(pattern, SIZE), exposure_us=16666.7, timestamp_ns=10**18 + index)


def test_a_recording_is_replayed(tmp_path: Path) -> None:
    folder = tmp_path / "capture"
    live = list(record(stream_of(photographs(), devices={"camera": "simulated: 1"}), folder).frames)
    recording = open_capture(folder)
    replayed = list(recording.stream().frames)
    assert recording.patterns == PATTERNS
    assert (recording.projector_size, recording.camera_size) == (SIZE, SIZE)
    assert [pattern for pattern, _ in replayed] == [pattern for pattern, _ in live]
    for (_, before), (_, after) in zip(live, replayed, strict=True):
        np.testing.assert_array_equal(before.image, after.image)
    assert recording.metadata["devices"] == {"camera": "simulated: 1"}
    assert recording.metadata["frames"][3]["exposure_us"] == 16666.7
    assert recording.metadata["frames"][3]["timestamp_ns"] == 10**18 + 3


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_every_frame_format_is_preserved(tmp_path: Path, dtype: Any, channels: tuple[int, ...]) -> None:
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (*SIZE[::-1], *channels)).astype(dtype)
    list(record(stream_of(iter([Frame(image)]), 1), tmp_path / "capture").frames)
    (replayed,) = read_all(tmp_path / "capture")
    np.testing.assert_array_equal(replayed, image)


def test_a_frame_is_on_disk_before_it_is_passed_on(tmp_path: Path) -> None:
    frames = record(stream_of(photographs()), tmp_path).frames
    for expected in (1, 2, 3):
        next(frames)
        assert len(open_capture(tmp_path).patterns) == expected


def test_a_device_that_fails_leaves_a_capture_of_the_frames_so_far(tmp_path: Path) -> None:
    def failing() -> Iterator[Frame]:
        yield Frame(draw(PATTERNS[0], SIZE))
        raise DeviceError("the lamp is off")

    with pytest.raises(DeviceError, match="lamp"):
        list(record(stream_of(failing()), tmp_path / "capture").frames)
    assert open_capture(tmp_path / "capture").patterns == PATTERNS[:1]


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, and the number of frames listed by then."""


def interrupt_at_line(number: int, folder: Path) -> Callable[[FrameType, str, Any], Any]:
    """A trace function that raises Ctrl-C at the n-th executed line of the modules that write a capture."""
    lines = count()

    def trace(frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code.co_filename not in (recorder.__file__, images.__file__):
            return None
        if event == "line" and next(lines) == number:
            raise Interrupted((folder / "capture.yaml").read_text().count("file:"))
        return trace

    return trace


def test_after_ctrl_c_at_any_moment_listing_and_frames_agree(tmp_path: Path) -> None:
    for number in count():
        folder = tmp_path / str(number)
        frames = record(stream_of(islice(photographs(), 4)), folder).frames
        next(frames)
        before = sys.gettrace()
        sys.settrace(interrupt_at_line(number, folder))
        try:
            rest, listed = sum(1 for _ in frames), 4
        except Interrupted as interruption:
            rest, listed = None, interruption.args[0]
        finally:
            sys.settrace(before)
        assert len(open_capture(folder).patterns) == listed  # what is listed is safe
        if rest == 3:
            break
    assert number > 50, "the interruptions did not reach into the writing"


def test_a_full_disk_keeps_the_earlier_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def half_written(path: Path, image: np.ndarray) -> None:
        write_png(path, image)
        if path.name == ".002.png":
            path.write_bytes(path.read_bytes()[:20])
            raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr(recorder, "write_png", half_written)
    with pytest.raises(OSError, match="space"):
        list(record(stream_of(photographs()), tmp_path / "capture").frames)
    assert len(read_all(tmp_path / "capture")) == 2


def test_a_capture_can_be_opened_by_its_listing(capture_folder: Path) -> None:
    assert open_capture(capture_folder / "capture.yaml") == open_capture(capture_folder)


def test_a_copy_holds_the_listing_and_the_listed_frames_only(capture_folder: Path, tmp_path: Path) -> None:
    (capture_folder / "notes.txt").write_text("of no interest")
    open_capture(capture_folder).copy_to(tmp_path / "copy")
    assert not (tmp_path / "copy" / "notes.txt").exists()
    for before, after in zip(read_all(capture_folder), read_all(tmp_path / "copy"), strict=True):
        np.testing.assert_array_equal(before, after)


def test_keys_of_other_readers_are_ignored(capture_folder: Path) -> None:
    listing = read_listing(capture_folder)
    listing |= {"lens": "f/2.8", "operator": {"name": "A. Operator"}}
    listing["camera"]["serial"] = 1234
    listing["frames"][0] |= {"exposure_us": 3, "pattern": {"kind": "white", "level": 255}}
    write_listing(capture_folder, listing)
    assert open_capture(capture_folder).patterns == PATTERNS


def test_an_image_beside_the_listing_is_not_an_extra_frame(capture_folder: Path) -> None:
    shutil.copy(capture_folder / "frames/000.png", capture_folder / "colour.png")
    (capture_folder / "frames" / ".thumbnail.png").touch()
    (capture_folder / "frames" / "notes.txt").touch()
    assert len(read_all(capture_folder)) == len(PATTERNS)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".bmp", ".pgm", ".webp"])
def test_every_format_of_opencv_is_read(tmp_path: Path, suffix: str) -> None:
    folder = write_capture(tmp_path / "room", (White(),))
    (folder / "frames/000.png").unlink()
    cv2.imwrite(str(folder / f"frames/000{suffix}"), draw(White(), SIZE))
    listing = read_listing(folder)
    listing["frames"][0]["file"] = f"frames/000{suffix}"
    write_listing(folder, listing)
    (image,) = read_all(folder)
    assert image.min() >= 250


def test_transparency_is_dropped(tmp_path: Path) -> None:
    folder = write_capture(tmp_path / "room", (White(),))
    write_png(folder / "frames/000.png", np.dstack([np.full(SIZE[::-1], value, np.uint8) for value in (1, 2, 3, 4)]))
    (image,) = read_all(folder)
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert image[0, 0].tolist() == [1, 2, 3]


@dataclass(frozen=True)
class Broken:
    """A way to damage a capture, and words of the expected message."""

    name: str
    break_it: Callable[[Path], object]
    words: tuple[str, ...]


def listing_with(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def break_it(folder: Path) -> None:
        listing = read_listing(folder)
        change(listing)
        write_listing(folder, listing)

    return break_it


def first_pattern(**pattern: object) -> Callable[[Path], None]:
    return listing_with(lambda listing: listing["frames"][0].update(pattern=pattern))


def first_file(file: object) -> Callable[[Path], None]:
    return listing_with(lambda listing: listing["frames"][0].update(file=file))


def truncate(folder: Path) -> None:
    frame = folder / "frames/004.png"
    frame.write_bytes(frame.read_bytes()[:-20])


def truncate_jpeg(folder: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, SIZE[::-1]).astype(np.uint8)
    data = cv2.imencode(".jpg", image)[1].tobytes()
    (folder / "frames/004.png").write_bytes(data[: len(data) // 2])


def damage(folder: Path) -> None:
    frame = folder / "frames/004.png"
    data = bytearray(frame.read_bytes())
    data[len(data) // 2] ^= 0xFF
    frame.write_bytes(bytes(data))


def replace_frame(image: np.ndarray) -> Callable[[Path], object]:
    return lambda folder: write_png(folder / "frames/004.png", image)


def link_out(folder: Path) -> None:
    outside = folder.parent / "secret.png"
    shutil.move(folder / "frames/004.png", outside)
    (folder / "frames/004.png").symlink_to(outside)


def link_folder_out(folder: Path) -> None:
    shutil.move(folder / "frames", folder.parent / "elsewhere")
    (folder / "frames").symlink_to(folder.parent / "elsewhere")


def link_in_a_circle(folder: Path) -> None:
    (folder / "frames/004.png").unlink()
    (folder / "frames/004.png").symlink_to("004.png")


def empty_frames(folder: Path) -> None:
    for path in (folder / "frames").iterdir():
        path.unlink()


def only_a_sequence(folder: Path) -> None:
    (folder / "capture.yaml").rename(folder / "sequence.yaml")


def only_a_result(folder: Path) -> None:
    (folder / "capture").mkdir()
    (folder / "capture.yaml").rename(folder / "capture/capture.yaml")


GRAY = {"kind": "gray", "axis": "x", "bit": 0, "bits": 3, "cell": 8, "offset": 0, "inverted": False}
PHASE = {"kind": "phase", "axis": "x", "period": 16.0, "shift": 0.0}

BROKEN = [
    Broken("no folder", shutil.rmtree, ("no such capture folder",)),
    Broken("no listing", lambda folder: (folder / "capture.yaml").unlink(), ("no capture.yaml",)),
    Broken("a sequence", only_a_sequence, ("sequence of patterns to project", "capture.yaml")),
    Broken("a result", only_a_result, ("found a result", "room/capture")),
    Broken("empty listing", lambda folder: (folder / "capture.yaml").write_text(""), ("'format' is missing",)),
    Broken("no YAML", lambda folder: (folder / "capture.yaml").write_text("a: [1,\nb"), ("line 2", "YAML")),
    Broken("a list", lambda folder: (folder / "capture.yaml").write_text("- 1"), ("found a list",)),
    Broken("not text", lambda folder: (folder / "capture.yaml").write_bytes(b"\xff\xfe\x00"), ("UTF-8",)),
    Broken("another format", listing_with(lambda x: x.update(format=2)), ("format 1", "found 2")),
    Broken("no camera", listing_with(lambda x: x.pop("camera")), ("'camera' is missing",)),
    Broken("no frames", listing_with(lambda x: x.update(frames=[])), ("'frames'", "at least 1")),
    Broken("no size", listing_with(lambda x: x["camera"].update(width=0)), ("camera.width", "greater than", "0")),
    Broken("missing frames", empty_frames, ("frames/000.png", "is missing, as are all others")),
    Broken("folder as frame", first_file("frames"), ("'frames'", "is no file")),
    Broken("path out", first_file("../secret.png"), ("../secret.png", "inside the capture folder")),
    Broken("detour out", first_file("frames/../../secret.png"), ("inside the capture folder",)),
    Broken("absolute path", first_file("/etc/hostname"), ("/etc/hostname", "inside the capture folder")),
    Broken("link out", link_out, ("004.png", "leads out")),
    Broken("folder linked out", link_folder_out, ("000.png", "leads out")),
    Broken("circular link", link_in_a_circle, ("004.png",)),
    Broken("endless name", first_file("x" * 5000), ("cannot be found",)),
    Broken("null in name", first_file("a\0b"), ("000.png", "is not listed")),
    Broken("number as name", first_file(7), ("frames[0].file", "string", "7")),
    Broken("same file twice", first_file("frames/001.png"), ("frame 1", "file", "frame 0")),
    Broken("unlisted frame", listing_with(lambda x: x["frames"].pop()), ("is not listed",)),
    Broken("unknown kind", first_pattern(kind="grey"), ("frames[0].pattern.kind", "'gray'", "'phase'", "'grey'")),
    Broken("no kind", first_pattern(axis="x"), ("frames[0].pattern.kind", "missing")),
    Broken("no pattern", listing_with(lambda x: x["frames"][0].pop("pattern")), ("frames[0].pattern", "missing")),
    Broken("unknown axis", first_pattern(**GRAY | {"axis": "z"}), ("frames[0].pattern.axis", "'x' or 'y'", "'z'")),
    Broken("bit beyond bits", first_pattern(**GRAY | {"bit": 3}), ("frames[0].pattern", "bit 3 of 3")),
    Broken("negative bit", first_pattern(**GRAY | {"bit": -1}), ("frames[0].pattern.bit", "-1")),
    Broken("no cell", first_pattern(**GRAY | {"cell": 0}), ("frames[0].pattern.cell", "0")),
    Broken("half a cell", first_pattern(**GRAY | {"cell": 0.5}), ("frames[0].pattern.cell", "0.5")),
    Broken("truth as number", first_pattern(**GRAY | {"bits": True}), ("frames[0].pattern.bits", "True")),
    Broken("number as truth", first_pattern(**GRAY | {"inverted": 1}), ("frames[0].pattern.inverted", "1")),
    Broken("no period", first_pattern(**PHASE | {"period": 0}), ("frames[0].pattern.period", "0")),
    Broken("negative period", first_pattern(**PHASE | {"period": -16.0}), ("frames[0].pattern.period", "-16")),
    Broken("endless period", first_pattern(**PHASE | {"period": float("inf")}), ("period", "finite")),
    Broken("shift that is none", first_pattern(**PHASE | {"shift": float("nan")}), ("shift", "finite")),
    Broken("truncated PNG", truncate, ("004.png", "truncated")),
    Broken("truncated JPEG", truncate_jpeg, ("004.png", "truncated")),
    Broken("damaged PNG", damage, ("004.png",)),
    Broken("empty file", lambda folder: (folder / "frames/004.png").write_bytes(b""), ("004.png", "empty")),
    Broken("text as image", lambda folder: (folder / "frames/004.png").write_text("hello"), ("004.png", "decoded")),
    Broken("smaller", replace_frame(np.zeros((16, 24), np.uint8)), ("004.png", "48 × 32", "24 × 16")),
    Broken("turned", replace_frame(np.zeros(SIZE, np.uint8)), ("004.png", "swapped")),
    Broken("deeper", replace_frame(np.zeros(SIZE[::-1], np.uint16)), ("004.png", "8-bit grey", "16-bit grey")),
    Broken("coloured", replace_frame(np.zeros((*SIZE[::-1], 3), np.uint8)), ("004.png", "8-bit colour")),
]


@pytest.mark.parametrize("case", BROKEN, ids=lambda case: case.name)
def test_a_malformed_capture_is_refused(capture_folder: Path, case: Broken) -> None:
    case.break_it(capture_folder)
    with pytest.raises(InputError) as caught:
        read_all(capture_folder)
    for word in case.words:
        assert word in str(caught.value)


def test_missing_files_are_left_out(capture_folder: Path) -> None:
    whole = open_capture(capture_folder)
    for number in (4, 7):
        (capture_folder / whole.files[number]).unlink()
    recording = open_capture(capture_folder)
    assert recording.files == tuple(file for number, file in enumerate(whole.files) if number not in (4, 7))
    assert recording.patterns == tuple(p for number, p in enumerate(whole.patterns) if number not in (4, 7))
    (finding,) = recording.findings
    assert (finding.kind, finding.data) == (MISSING_FILES, {"missing_frames": 2.0})
    assert "'frames/004.png', 'frames/007.png'" in finding.message
    assert len(list(recording.stream().frames)) == len(whole.files) - 2


def test_the_folder_of_the_frames_is_that_capture(capture_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_capture(capture_folder / "frames") == open_capture(capture_folder)
    monkeypatch.chdir(capture_folder)
    assert open_capture(Path("frames")).files == open_capture(capture_folder).files
    monkeypatch.chdir(capture_folder.parent)
    assert open_capture(Path(capture_folder.name) / "frames").folder == Path(capture_folder.name)


def test_floating_point_frames_are_refused(tmp_path: Path) -> None:
    folder = write_capture(tmp_path / "room", (Gray("x", 0, 1),))
    data = cv2.imencode(".tiff", np.zeros(SIZE[::-1], np.float32))[1].tobytes()
    (folder / "frames/000.png").write_bytes(data)
    with pytest.raises(InputError, match=r"8 or 16 bit .* found float32"):
        read_all(folder)
