"""Phases that a projector's gamma bends are straightened by their own distribution."""

import numpy as np
import pytest

from scanner.decoding import Fringe
from scanner.decoding.fringes.single_fringe import TABLE_LENGTH, straightening


@pytest.mark.parametrize(("steps", "gamma"), [(3, 1.6), (3, 2.2), (4, 1.6), (4, 3.0)])
def test_a_bent_phase_is_straightened(steps: int, gamma: float) -> None:
    fringe = Fringe("x", 16.0, tuple(0.1 + k / steps for k in range(steps)), tuple(range(steps)))
    truth = np.random.default_rng(1).uniform(0, 2 * np.pi, 40_000)
    light = (0.5 + 0.5 * np.cos(truth + 2 * np.pi * np.array(fringe.shifts)[:, None])) ** gamma
    _, cosine, sine = fringe.weights @ light
    measured = np.mod(np.arctan2(sine, cosine), 2 * np.pi).astype(np.float32)
    table = straightening(fringe, [measured])
    assert table is not None
    straight = measured + table[(measured * TABLE_LENGTH / (2 * np.pi)).astype(int) % TABLE_LENGTH]
    before, after = (np.std(np.angle(np.exp(1j * (phase - truth)))) for phase in (measured, straight))
    assert 1e-5 < after < before / 5
    assert after < 0.01


def test_a_straight_phase_is_left_alone() -> None:
    fringe = Fringe("x", 16.0, (0.0, 1 / 3, 2 / 3), (0, 1, 2))
    measured = np.random.default_rng(1).uniform(0, 2 * np.pi, 20_000).astype(np.float32)
    assert straightening(fringe, [measured]) is None
