"""Frames that do not show what the capture says: an error that names them, or coordinates that are right anyway."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_capture import Scene, decode

from scanner.errors import InputError
from scanner.patterns import Pattern, sequence_for

SCENE = Scene()
SEQUENCES = {
    "standard": sequence_for(SCENE.projector),
    "quick": sequence_for(SCENE.projector, inverses=False, shifts=4),
    "Gray only": sequence_for(SCENE.projector, cell=1, shifts=0)[2:],
}
FRAMES = {name: SCENE.frames(patterns) for name, patterns in SEQUENCES.items()}


def _right_or_refused(patterns: tuple[Pattern, ...], frames: list[np.ndarray]) -> None:
    try:
        decoding = decode(patterns, frames, SCENE.projector)
    except InputError:
        return
    error = np.abs(SCENE.errors(decoding)).max(axis=1)
    assert np.median(error) < 0.6


@settings(max_examples=25, deadline=None)
@given(data=st.data(), name=st.sampled_from(sorted(SEQUENCES)))
def test_two_frames_exchanged(data: st.DataObject, name: str) -> None:
    frames = list(FRAMES[name])
    places = st.integers(0, len(frames) - 1)
    i, j = data.draw(places), data.draw(places)
    frames[i], frames[j] = frames[j], frames[i]
    _right_or_refused(SEQUENCES[name], frames)


@pytest.mark.parametrize("name", sorted(SEQUENCES))
@pytest.mark.parametrize(("i", "j"), [(0, 1), (2, 3), (2, 4)])
def test_the_first_frames_exchanged_are_noticed_and_named(name: str, i: int, j: int) -> None:
    frames = list(FRAMES[name])
    frames[i], frames[j] = frames[j], frames[i]
    with pytest.raises(InputError, match="frame"):
        decode(SEQUENCES[name], frames, SCENE.projector)


@pytest.mark.parametrize("name", sorted(SEQUENCES))
def test_frames_in_order_raise_no_alarm(name: str) -> None:
    assert len(decode(SEQUENCES[name], FRAMES[name], SCENE.projector).matches) > 10_000
