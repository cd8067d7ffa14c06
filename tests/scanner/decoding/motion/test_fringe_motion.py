"""Independent shifts of single frames are distinguished from changes of light."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.decoding.motion.fringe_motion import FrameShifts

COUNT = 8


def shifts(shift_px: np.ndarray, by_shifts: float = 0.9) -> FrameShifts:
    return FrameShifts(np.arange(COUNT), shift_px, 1e-4 * np.eye(2 * COUNT), by_shifts, by_event=0.6)


@given(seed=st.integers(0, 1000), size_px=st.floats(0.1, 0.5))
def test_shifts_of_all_frames_are_distinguished_from_light(seed: int, size_px: float) -> None:
    found = shifts(np.random.default_rng(seed).choice([-1, 1], (2, COUNT)) * size_px)
    assert found.is_no_event
    assert found.are_distinct_from_light


@pytest.mark.parametrize(("share", "is_motion"), [(0.45, True), (0.85, False), (0.97, False)])
def test_ghosting_in_a_frame_is_not_taken_for_shifts(share: float, is_motion: bool) -> None:
    squares = np.full(COUNT, (1 - share) / (COUNT - 2))
    squares[[1, 6]] = share / 2
    assert shifts(0.5 * np.sqrt(np.stack([squares, squares]))).are_distinct_from_light == is_motion


@pytest.mark.parametrize(("by_shifts", "is_motion"), [(0.3, False), (0.8, True)])
def test_what_shifts_do_not_explain_is_light(by_shifts: float, is_motion: bool) -> None:
    assert shifts(np.full((2, COUNT), 0.2), by_shifts).are_distinct_from_light == is_motion
