"""Recordings interrupted at any point: complete frames are read, damaged ones are left out with a note."""

import shutil
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.rig import Frame
from scanner.capture.recorder import record
from scanner.capture.recording import open_capture
from scanner.capture.stream import Stream
from scanner.errors import InputError
from scanner.patterns import draw
from tests.support import small_capture
from tests.support.small_capture import SIZE, write_capture

PATTERNS = small_capture.PATTERNS[:9]
ACCOUNT = {"synchronisation": {"latency_ms": 50.1, "overlapping": True}}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "capture"
    frames = ((pattern, Frame(draw(pattern, SIZE), 16666.7, 10**18)) for pattern in PATTERNS)
    list(record(Stream(PATTERNS, SIZE, SIZE, frames, {"devices": {"camera": "a"}}, lambda: ACCOUNT), folder).frames)
    return folder


def cut(recorded: Path, folder: Path, text: bytes) -> Path:
    """The recording with its listing cut to `text`."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(recorded, folder)
    (folder / "capture.yaml").write_bytes(text)
    for path in sorted((folder / "frames").iterdir())[text.count(b"file: frames/") :]:
        path.unlink()
    return folder


@settings(max_examples=30)
@given(share=st.floats(0, 1))
def test_a_truncated_listing_is_read_to_its_last_complete_line(
    recorded: Path, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    whole = (recorded / "capture.yaml").read_bytes()
    first, last = whole.index(b"  - {file"), len(whole)
    end = first + round(share * (last - first))
    folder = cut(recorded, tmp_path_factory.getbasetemp() / "cut", whole[:end])
    count = whole[:end].count(b"}, exposure_us: 16666.7, timestamp_ns: 1000000000000000000}")
    if count == 0:
        with pytest.raises(InputError, match="no frame was recorded"):
            open_capture(folder)
        return
    found = open_capture(folder)
    assert found.patterns == PATTERNS[:count]
    assert found.planned == PATTERNS
    assert len(found.findings) <= 2  # the line, and the image that it was about
    assert sum(1 for _ in found.stream().frames) == count


def test_the_listing_may_be_cut_at_any_byte(recorded: Path, tmp_path: Path) -> None:
    """The brackets of a line show whether it is complete."""
    whole = (recorded / "capture.yaml").read_bytes()
    begin = whole.rindex(b"  - {file")
    folder = cut(recorded, tmp_path / "cut", whole)
    counts = set()
    for end in range(begin, len(whole), 3):
        (folder / "capture.yaml").write_bytes(whole[:end])
        counts.add(len(open_capture(folder).patterns))
    assert counts == {len(PATTERNS) - 1, len(PATTERNS)}


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_damaged_last_image_is_left_out_with_a_note(recorded: Path, tmp_path: Path, share: float) -> None:
    folder = cut(recorded, tmp_path / "cut", (recorded / "capture.yaml").read_bytes())
    last = sorted((folder / "frames").iterdir())[-1]
    last.write_bytes(last.read_bytes()[: int(share * last.stat().st_size)])
    found = open_capture(folder)
    assert found.patterns == PATTERNS[:-1]
    assert f"The last frame, frames/{last.name}, is left out" in found.findings[0].message
    last.unlink()
    assert "cannot be read" in open_capture(folder).findings[0].message
    found.copy_to(tmp_path / "copy")
    assert len(open_capture(tmp_path / "copy").patterns) == len(PATTERNS) - 1


def test_an_unlisted_image_is_left_out(recorded: Path, tmp_path: Path) -> None:
    lines = (recorded / "capture.yaml").read_bytes().split(b"  - {file: frames/007.png")[0]
    folder = cut(recorded, tmp_path / "cut", lines)
    for name in ("007.png", "008.png"):
        shutil.copy(recorded / "frames" / name, folder / "frames")
        if name == "007.png":
            found = open_capture(folder)
            assert found.patterns == PATTERNS[:7]
            assert "007.png is left out" in found.findings[0].message
    with pytest.raises(InputError, match=r"008\.png is not listed"):
        open_capture(folder)


def test_a_sequence_key_of_another_program_is_ignored(tmp_path: Path) -> None:
    folder = write_capture(tmp_path / "room")
    with (folder / "capture.yaml").open("a") as file:
        file.write("sequence: [gray, phase]\n")
    assert open_capture(folder).planned == ()
