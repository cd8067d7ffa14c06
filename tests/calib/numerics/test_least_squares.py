"""Damping rises with each failure in a row, and faster each time."""

from dataclasses import replace

import numpy as np
import pytest

from calib.numerics import Damping, Floats, Quadratic, descend

SLOPE, CURVATURE = np.array([3.0]), np.array([[2.0]])


@pytest.mark.parametrize(
    ("acceleration", "levels"),
    [(1.0, [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]), (3.0, [1.0, 2.0, 12.0, 216.0])],
)
def test_each_failure_raises_the_damping_until_it_is_too_high(acceleration: float, levels: list[float]) -> None:
    used = []

    def fail(at: Quadratic, step: Floats) -> Quadratic:
        used.append(-SLOPE[0] / (CURVATURE[0, 0] * step[0]) - 1)  # a damped step is −slope / (curvature (1 + level))
        return replace(at, cost=at.cost + 1)

    start = Quadratic(5.0, SLOPE, CURVATURE)
    damping = Damping(1.0, 1e-9, 100.0, growth=2.0, relief=0.1, acceleration=acceleration)
    assert descend(start, fail, lambda *_: False, damping, 50) is start
    assert used == pytest.approx(levels)


def test_a_success_resets_the_growth() -> None:
    used = []

    def alternate(at: Quadratic, step: Floats) -> Quadratic:
        used.append(-SLOPE[0] / (CURVATURE[0, 0] * step[0]) - 1)
        return replace(at, cost=at.cost + (1 if len(used) % 2 else -1))

    damping = Damping(1.0, 1e-9, 100.0, growth=4.0, relief=0.5, acceleration=3.0)
    descend(Quadratic(5.0, SLOPE, CURVATURE), alternate, lambda *_: False, damping, 5)
    assert used == pytest.approx([1.0, 4.0, 2.0, 8.0, 4.0])
