"""What a person is told to do."""

import numpy as np
import pytest

from calib.diagnostics import NextView


@pytest.mark.parametrize(
    ("right_deg", "up_deg", "distance", "words"),
    [
        (25.0, 0.0, 1.0, "25° to the right"),
        (-25.0, 0.0, 1.0, "25° to the left"),
        (0.0, 15.0, 1.0, "15° upwards"),
        (0.0, -15.0, 0.7, "15° downwards and closer, to 0.7 × the distance"),
        (25.0, -15.0, 1.0, "25° to the right and 15° downwards"),
        (-25.0, 15.0, 1.3, "25° to the left, 15° upwards and farther away, to 1.3 × the distance"),
    ],
)
def test_moves_are_told_in_words(right_deg: float, up_deg: float, distance: float, words: str) -> None:
    assert NextView(right_deg, up_deg, distance, 0.01, np.zeros(3)).words == words
