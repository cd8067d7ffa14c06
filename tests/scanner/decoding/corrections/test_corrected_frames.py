"""Frames as they are read from the images of a capture."""

import numpy as np
import pytest

from scanner.decoding import plan_sequence
from scanner.decoding.corrections import CorrectedFrames, FrameGains
from scanner.decoding.light import Gains
from scanner.patterns import phase_sequence

PART = slice(8, 40), slice(16, 64)


@pytest.mark.parametrize("gain", [None, 1.5])
def test_a_stack_holds_the_frames_that_are_read_one_by_one(gain: float | None) -> None:
    """Whole grey levels as they were kept, and fractions of those that were equalised."""
    plan = plan_sequence([*phase_sequence("x", 40, 4), *phase_sequence("y", 40, 4)], (40, 40))
    rng = np.random.default_rng(0)
    taken = rng.integers(0, 255, (len(plan.shown), 64, 80)).astype(np.uint8)
    frames, numbers = CorrectedFrames(plan, taken), plan.x.fringes[0].frames
    if gain:
        of_steps = Gains(np.array([[gain], [gain], [1.0], [1.0]]))
        frames = frames.with_gains(FrameGains({}, {numbers: of_steps}))
    stack, places, (top, left) = frames.stacked(PART, numbers)
    height, width = 32, 48
    for number, frame in frames.by_number(PART, numbers):
        np.testing.assert_array_equal(stack[places[number], top : top + height, left : left + width], frame)
        raw = taken[plan.shown.index(number)][PART]
        expected = raw if not gain else raw / np.float32(gain if number in numbers[:2] else 1.0)
        np.testing.assert_allclose(frame, expected, rtol=1e-6)
