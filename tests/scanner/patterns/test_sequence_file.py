from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from scanner.capture import open_capture
from scanner.errors import InputError
from scanner.patterns.pattern import Axis, Black, Gray, Pattern, Phase, White, Xor, draw, sequence_for
from scanner.patterns.sequence_file import PatternEntry, frame_line, pattern_to_dict, write_sequence

axes: st.SearchStrategy[Axis] = st.sampled_from(["x", "y"])


@st.composite
def gray_codes(draw_one: st.DrawFn) -> Gray:
    bits = draw_one(st.integers(1, 32))
    bit = draw_one(st.integers(0, bits - 1))
    offset = draw_one(st.integers(0, 2**32))
    return Gray(draw_one(axes), bit, bits, draw_one(st.integers(1, 1000)), offset, draw_one(st.booleans()))


@st.composite
def xor_codes(draw_one: st.DrawFn) -> Xor:
    bits = draw_one(st.integers(2, 32))
    bit, base = draw_one(st.lists(st.integers(0, bits - 1), min_size=2, max_size=2, unique=True))
    return Xor(draw_one(axes), bit, bits, base, draw_one(st.integers(1, 1000)), draw_one(st.integers(0, 2**32)))


fringes = st.builds(Phase, axes, st.floats(2, 1e6), st.floats(-10, 10))
patterns = st.just(White()) | st.just(Black()) | gray_codes() | xor_codes() | fringes


@given(patterns)
def test_a_pattern_reads_back_the_same(pattern: Pattern) -> None:
    (entry,) = yaml.safe_load(frame_line("frames/000.png", pattern))
    assert entry["file"] == "frames/000.png"
    assert entry["pattern"] == pattern_to_dict(pattern)
    assert TypeAdapter(PatternEntry).validate_python(entry["pattern"]).pattern() == pattern


def test_the_keys_of_the_file_format_are_fixed() -> None:
    assert pattern_to_dict(Gray("x", 0, 10)) == {
        "kind": "gray",
        "axis": "x",
        "bit": 0,
        "bits": 10,
        "cell": 1,
        "offset": 0,
        "inverted": False,
    }
    assert pattern_to_dict(Xor("y", 0, 10, 9, 4)) == {
        "kind": "xor",
        "axis": "y",
        "bit": 0,
        "bits": 10,
        "base": 9,
        "cell": 4,
        "offset": 0,
        "inverted": False,
    }
    assert pattern_to_dict(Phase("y", 16.0, 0.25)) == {"kind": "phase", "axis": "y", "period": 16.0, "shift": 0.25}
    assert pattern_to_dict(White()) == {"kind": "white"}
    assert pattern_to_dict(Black()) == {"kind": "black"}


def test_a_sequence_holds_each_pattern_as_an_image(tmp_path: Path) -> None:
    size = (70, 50)
    sequence = sequence_for(size)
    write_sequence(tmp_path, sequence, size)
    listing = yaml.safe_load((tmp_path / "sequence.yaml").read_text())
    assert listing["format"] == 1
    assert listing["projector"] == {"width": 70, "height": 50}
    assert "camera" not in listing
    assert len(listing["frames"]) == len(sequence)
    for entry, pattern in zip(listing["frames"], sequence, strict=True):
        image = cv2.imread(str(tmp_path / entry["file"]), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(image, draw(pattern, size))
        assert entry["pattern"] == pattern_to_dict(pattern)


def test_a_sequence_becomes_a_capture_when_the_camera_is_added(tmp_path: Path) -> None:
    write_sequence(tmp_path, sequence_for((70, 50)), (70, 50))
    with pytest.raises(InputError, match="sequence of patterns to project"):
        open_capture(tmp_path)
    text = (tmp_path / "sequence.yaml").read_text()
    (tmp_path / "capture.yaml").write_text(text + "camera: {width: 70, height: 50}\n")
    recording = open_capture(tmp_path)
    assert recording.patterns == sequence_for((70, 50))
    assert len(list(recording.stream().frames)) == len(recording.patterns)
