"""A measured response makes fringes true sines without changing the meaning of the recording."""

from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hw.simulated import SimulatedRoom
from scanner.capture import capture
from scanner.checking.light import photograph_light
from scanner.checking.response import measure_ramp
from scanner.decoding import Decoder
from scanner.patterns import PRESETS, Phase, ProjectorResponse, draw
from tests.support.rig_bench import PROJECTOR, changed, rig_in

QUICK = PRESETS["quick"].patterns(PROJECTOR)
PERIOD_PX = PRESETS["quick"].periods[0]


def ripple_px(room: SimulatedRoom, response: ProjectorResponse | None) -> float:
    """Amplitude of the error of x at four times the frequency of the fringe, where it does not depend on the scene."""
    stream = capture(rig_in(room), QUICK, response=response)
    decoder = Decoder(stream.patterns, PROJECTOR)
    for _, frame in stream.frames:
        decoder.add(frame.image)
    matches = decoder.finish().matches
    column, row = matches.camera_px.astype(int).T
    true = room.ground_truth().projector_px[row, column, 0]
    error = matches.projector_px[:, 0] - true
    near = np.abs(error) < 0.5
    angle = 2 * np.pi * 4 * true[near] / PERIOD_PX
    design = np.stack([np.ones(near.sum()), np.cos(angle), np.sin(angle)], axis=1)
    _, cosine, sine = np.linalg.lstsq(design, error[near], rcond=None)[0]
    return float(np.hypot(cosine, sine))


def test_the_ripple_of_the_quick_preset_falls(room: SimulatedRoom) -> None:
    bent = changed(room, gamma=2.6, projector_blur_px=0.3, ambient=0.02)
    rig = rig_in(bent)
    response = measure_ramp(rig, photograph_light(rig, 2, 2)).response
    before, after = ripple_px(bent, None), ripple_px(bent, response)
    assert 0.005 < before < 0.1
    assert after < 0.5 * before
    assert after < 0.005


def test_a_compensated_fringe_is_a_sine_of_light() -> None:
    response = ProjectorResponse(tuple(np.linspace(0, 1, 16) ** 2.2))
    pattern = Phase("x", 37.3, 0.25)
    size = (400, 2)
    sent = response.compensation[draw(pattern, size)]
    light = (sent[0] / 255) ** 2.2
    wanted = pattern.brightness(np.arange(400.0), np.zeros(400))
    assert 1e-4 < np.abs(light - wanted).max() < 0.012
    assert np.std(light - wanted) < 0.004
    bent = (draw(pattern, size)[0] / 255) ** 2.2
    assert np.abs(bent - wanted).max() > 0.15


def test_recordings_state_the_compensation(room: SimulatedRoom) -> None:
    stream = capture(rig_in(room), QUICK, response=ProjectorResponse((0.0, 0.3, 1.0)))
    assert stream.patterns == QUICK
    devices = cast(dict[str, str], stream.metadata["devices"])
    assert devices["response"] == "gamma 1.74, undone"


@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=40))
def test_compensation_is_monotone_and_keeps_black_and_white(steps: list[float]) -> None:
    light = np.concatenate([[0.0], np.cumsum(steps)])
    light = light / light[-1]
    response = ProjectorResponse((*light[:-1], 1.0))
    levels = response.compensation.astype(int)
    assert (levels[0], levels[-1]) == (0, 255)
    assert np.all(np.diff(levels) >= 0)
    # Rounded to whole levels, the light is off by at most half the step between two of them.
    off = np.abs(response.of_levels[levels] - np.arange(256) / 255)
    assert off.max() <= np.diff(response.of_levels).max()


@pytest.mark.parametrize("gamma", [0.8, 1.0, 2.2, 3.0])
def test_gamma_of_a_power_law(gamma: float) -> None:
    response = ProjectorResponse(tuple(np.linspace(0, 1, 16) ** gamma))
    assert response.gamma == pytest.approx(gamma, abs=0.006)
    assert response.off_power_law < 0.002
