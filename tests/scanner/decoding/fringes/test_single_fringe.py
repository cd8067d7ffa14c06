"""Phases that a response bends are straightened, and a fringe that nothing checks has a sigma that covers its error."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanner.decoding import Fringe
from scanner.decoding.fringes.single_fringe import TABLE_LENGTH, FringeSample, Response, response_of, straightening
from scanner.patterns import Pattern, phase_sequence
from tests.support.findings import kinds_of, the_only
from tests.support.synthetic_capture import Scene

SCENE = Scene(electrons_per_level=300.0, read_noise=0.3)
STEPS = (0.0, 1 / 3, 2 / 3)


def long_fringes(steps: int) -> tuple[Pattern, ...]:
    width, height = SCENE.projector
    return (*phase_sequence("x", float(width), steps), *phase_sequence("y", float(height), steps))


@pytest.mark.parametrize(("gamma", "steps"), [(1.0, 3), (1.8, 3), (3.0, 3), (1.8, 4)])
def test_errors_match_their_sigmas_for_any_gamma(gamma: float, steps: int) -> None:
    scene = replace(SCENE, gamma=gamma)
    decoding = scene.decode(long_fringes(steps))
    assert decoding.matches.sigma_px is not None
    relative = np.abs(scene.errors(decoding)) / np.asarray(decoding.matches.sigma_px)[:, None]
    assert 0.05 < np.median(relative) < 1.2
    assert np.percentile(relative, 90) < 3
    assert 0.5 < np.median(decoding.matches.sigma_px) < 8
    assert f"{steps} steps" in the_only("unchecked-fringe", decoding.findings).message
    assert "flicker" not in kinds_of(decoding.findings)


def test_the_unknown_response_gives_a_common_systematic_shift() -> None:
    decoding = SCENE.decode(long_fringes(3))
    (shift,) = decoding.shifts
    projector_px = np.asarray(decoding.matches.projector_px, np.float64)
    shifts = shift(projector_px, projector_px, np.empty((len(projector_px), 2, 2)))
    assert shifts.shape == projector_px.shape
    assert 0.01 < np.abs(shifts).max() < 5
    third = projector_px + np.array([SCENE.projector[0] / 3, 0.0])
    np.testing.assert_allclose(shift(third, third, np.empty((len(third), 2, 2))), shifts, atol=0.05)


@given(
    exponent=st.floats(0.5, 3.0),
    ambient=st.floats(0, 0.1),
    shades=st.floats(0.2, 1.0),
    seed=st.integers(0, 99),
    begin=st.sampled_from([0.0, 0.05, 0.25]),
)
@settings(max_examples=30)
def test_the_response_is_read_from_amplitudes(
    exponent: float, ambient: float, shades: float, seed: int, begin: float
) -> None:
    rng = np.random.default_rng(seed)
    steps = tuple(begin + step for step in STEPS)
    fringe, truth = Fringe("x", 300.0, steps, (0, 1, 2)), rng.uniform(0, 2 * np.pi, 4000)
    paint = rng.uniform(shades, 1, len(truth))
    shown = (1 + np.cos(truth + 2 * np.pi * np.array(steps)[:, None])) / 2
    levels = paint * shown**exponent + ambient
    phasor = np.array([1, 1j]) @ (fringe.weights[1:] @ levels)
    phases = np.angle(phasor)
    found = response_of([FringeSample(fringe, phases, np.log(np.abs(phasor)), np.log(levels.mean(axis=0)))])
    assert 0 < abs(found.exponent - exponent) / found.sigma < 5
    off = np.angle(np.exp(1j * (phases - truth)))
    table = found.straightening(fringe)
    straightened = off + table[np.floor(np.mod(phases, 2 * np.pi) / (2 * np.pi) * len(table)).astype(int)]
    assert np.abs(straightened).mean() < 0.08


def test_too_few_pixels_give_the_prior() -> None:
    fringe, few = Fringe("x", 300.0, STEPS, (0, 1, 2)), np.linspace(0, 6, 50)
    found: Response = response_of([FringeSample(fringe, few, few * 0, few * 0)])
    assert 1.5 < found.exponent < 2.0
    assert 0.7 < found.sigma < 0.9
    assert 0.1 < np.abs(found.residual(fringe)).max() < 0.3


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
