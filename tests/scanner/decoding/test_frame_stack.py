"""Frames are stored as taken, in memory or in a file."""

import numpy as np
import pytest

from scanner.decoding import frame_stack
from scanner.decoding.frame_stack import FrameCollector, room_for_frames
from scanner.errors import InputError
from scanner.patterns import sequence_for
from tests.support.synthetic_capture import Scene, decode

SHAPE = (3, 4)


@pytest.fixture(params=["in memory", "in a file"])
def memory(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Simulate a machine with much or little memory."""
    monkeypatch.setattr(frame_stack, "total_bytes", lambda: 1 << 40 if request.param == "in memory" else 1)
    return str(request.param)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_frames_are_kept_in_order(memory: str, dtype: type[np.unsignedinteger]) -> None:
    scene = Scene()
    patterns = sequence_for(scene.projector)
    frames = [frame.astype(dtype) for frame in scene.frames(patterns)]
    collector = FrameCollector(patterns, scene.projector, calibrated=False)
    for frame in frames:
        collector.add(frame)
    stack = collector.complete()
    assert np.array_equal(stack.frames, np.stack(frames))
    assert isinstance(stack.frames, np.memmap) == (memory == "in a file")
    assert np.array_equal(stack.texture, frames[0]), "white is the first"


def test_a_mapped_capture_decodes_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    patterns = sequence_for(scene.projector)
    frames = scene.frames(patterns)
    usual = decode(patterns, frames, scene.projector)
    monkeypatch.setattr(frame_stack, "total_bytes", lambda: 1)
    mapped = decode(patterns, frames, scene.projector)
    assert len(usual.matches) > 1000
    assert np.array_equal(usual.matches.projector_px, mapped.matches.projector_px)


def test_a_full_disk_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(frame_stack, "total_bytes", lambda: 1)
    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(InputError, match="set TMPDIR to a folder with room"):
        room_for_frames(4, np.zeros(SHAPE, np.uint8), codes_alone=False)
