"""Frames are stored as taken, in memory or in a file."""

import numpy as np
import pytest

from calib.numerics import Image
from scanner.decoding.corrections import corrected_frames
from scanner.decoding.corrections.corrected_frames import Stack
from scanner.errors import InputError
from scanner.patterns import sequence_for
from tests.support.synthetic_capture import Scene, decode

SHAPE = (3, 4)


@pytest.fixture(params=["in memory", "in a file"])
def memory(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Simulate a machine with much or little memory."""
    monkeypatch.setattr(corrected_frames, "total_bytes", lambda: 1 << 40 if request.param == "in memory" else 1)
    return str(request.param)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_frames_are_kept_in_order(memory: str, dtype: type[np.unsignedinteger]) -> None:
    frames: list[Image] = [np.full(SHAPE, 10 * number, dtype) for number in range(4)]
    kept = Stack(len(frames), frames[0], codes_alone=False)
    for number, frame in enumerate(frames):
        assert np.array_equal(kept.keep(frame), frame)
        assert len(kept.frames) == number + 1
    assert np.array_equal(kept.frames, np.stack(frames))
    assert isinstance(kept.frames, np.memmap) == (memory == "in a file")


def test_a_mapped_capture_decodes_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    patterns = sequence_for(scene.projector)
    frames = scene.frames(patterns)
    usual = decode(patterns, frames, scene.projector)
    monkeypatch.setattr(corrected_frames, "total_bytes", lambda: 1)
    mapped = decode(patterns, frames, scene.projector)
    assert len(usual.matches) > 1000
    assert np.array_equal(usual.matches.projector_px, mapped.matches.projector_px)


def test_a_full_disk_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(corrected_frames, "total_bytes", lambda: 1)
    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(InputError, match="set TMPDIR to a folder with room"):
        Stack(4, np.zeros(SHAPE, np.uint8), codes_alone=False)
