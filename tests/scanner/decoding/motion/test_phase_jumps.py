"""The middle of an arc of phases, by which a code is shifted against its fringes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scanner.decoding.motion.phase_jumps import middle_of


@given(
    turned=st.floats(-3.0, 3.0),
    width=st.floats(0.05, 0.95),
    kept=st.floats(0.5, 1.0),
    seed=st.integers(0, 99),
)
def test_the_middle_of_an_unevenly_filled_arc(turned: float, width: float, kept: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-width / 2, width / 2, 3000)
    turns = turns[(turns < width / 6) | (rng.uniform(size=len(turns)) < kept)]
    noisy = turned + 2 * np.pi * (turns + rng.normal(0, 0.003, len(turns)))
    off = np.angle(np.exp(1j * (middle_of(noisy.astype(np.float32), width) - turned))) / (2 * np.pi)
    assert abs(off) < 0.015
