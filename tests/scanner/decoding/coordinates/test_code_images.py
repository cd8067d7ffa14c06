"""Frames as they are read from the images of a capture."""

import numpy as np
import pytest

from scanner.decoding import Samples, plan_sequence
from scanner.decoding.coordinates import CodeImages
from scanner.decoding.corrections import CorrectedFrames
from scanner.patterns import phase_sequence

PART = slice(8, 40), slice(16, 64)


@pytest.mark.parametrize("gain", [None, 1.5])
def test_a_stack_holds_the_frames_that_are_read_one_by_one(gain: float | None) -> None:
    """Whole grey levels as they were kept, and fractions of those that were equalised."""
    plan = plan_sequence([*phase_sequence("x", 40, 4), *phase_sequence("y", 40, 4)], (40, 40))
    rng = np.random.default_rng(0)
    taken = rng.integers(0, 255, (len(plan.shown), 64, 80)).astype(np.uint8)
    frames = CorrectedFrames(plan, taken)
    samples = Samples.read(plan, (64, 80), frames.read)
    images = CodeImages(frames, samples.scattered)
    numbers = plan.x.fringes[0].frames
    if gain:
        images.equalise(numbers[:2], lambda _number, image, _part: image.astype(np.float32) / np.float32(gain))
    stack, places, (top, left) = images.stacked(PART, numbers)
    height, width = 32, 48
    for number, frame in images.equalised(PART, numbers):
        np.testing.assert_array_equal(stack[places[number], top : top + height, left : left + width], frame)
