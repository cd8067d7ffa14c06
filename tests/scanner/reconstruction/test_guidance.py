"""Advice between captures: the next view, its gain, and when captures suffice."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.diagnostics import NextView, moved_corner, step_taken
from calib.geometry import Calibration, Matches
from calib.refinement import PlacedCorner
from calib.synthetic import PAPER_CAMERA, random_captures
from scanner.capture import CaptureMetadata
from scanner.configuration import Config
from scanner.reconstruction.guidance import Guidance, guide, where_to
from scanner.results import Decoded, GivenMatches

CONFIG = Config.model_validate(
    {"scale": {"baseline_m": 0.5}, "camera": {"principal_point": {"known": PAPER_CAMERA.principal_point_px}}}
)


def told(captures: Sequence[Matches], calibration: Calibration) -> Guidance:
    metadata = CaptureMetadata(calibration.camera.size, calibration.projector.size)
    decoded = [
        Decoded(metadata, matches, GivenMatches(), f"Capture {n}") for n, matches in enumerate(captures, start=1)
    ]
    return guide(decoded, CONFIG)[0]


@pytest.fixture(scope="module")
def twice() -> tuple[list[Matches], Calibration]:
    rng = np.random.default_rng(7)
    taken = random_captures(rng, 2, count=5000, walls_off_deg=0.3, noise_px=0.05, distance=(1.5, 2.5))
    return [each.matches for each in taken], taken[0].calibration


def test_one_capture_is_insufficient_and_a_next_view_is_proposed(twice: tuple[list[Matches], Calibration]) -> None:
    matches, calibration = twice
    first = told(matches[:1], calibration)
    assert not first.enough
    assert any("move" in sentence and "°" in sentence for sentence in first.sentences)


def test_a_sufficient_set_of_captures_is_recognised(twice: tuple[list[Matches], Calibration]) -> None:
    matches, calibration = twice
    last = told(matches, calibration)
    assert last.enough
    assert any(sentence.startswith("That is enough to measure.") for sentence in last.sentences)


def test_a_repeated_view_is_reported_as_useless(twice: tuple[list[Matches], Calibration]) -> None:
    matches, calibration = twice
    again = matches[0].with_faces(matches[0].labels)
    assert any("count as one" in sentence for sentence in told([matches[0], again], calibration).sentences)


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(0.5, 2.0))
@settings(max_examples=50)
def test_the_proposed_step_and_turn_keep_the_corner_in_view(right: float, up: float, far: float) -> None:
    vertex = np.array([0.3, -0.2, 5.0])
    corner = PlacedCorner(np.eye(3), vertex, 0)
    step = step_taken(corner, right, up, far)
    turned = moved_corner(corner, right, up, far)
    np.testing.assert_allclose(turned.frame.T @ (vertex - step), far * vertex, atol=1e-9)
    assert np.linalg.norm(vertex - step) == pytest.approx(far * np.linalg.norm(vertex))


@pytest.mark.parametrize(
    ("right", "up", "distance", "words"),
    [
        (-25.0, 0.0, 0.75, ("to the left", "forward", "turn it 25° to the right")),
        (25.0, 0.0, 1.0, ("m to the right", "turn it 25° to the left")),
        (0.0, 25.0, 1.3, ("m up", "back", "turn it 25° down")),
        (0.0, -25.0, 1.0, ("m down", "turn it 25° up")),
    ],
)
def test_directions_to_the_operator(
    twice: tuple[list[Matches], Calibration], right: float, up: float, distance: float, words: tuple[str, ...]
) -> None:
    step = step_taken(PlacedCorner(np.eye(3), np.array([0.0, 0.0, 5.0]), 0), right, up, distance)
    said = where_to(NextView(right, up, distance, 0.01, step), twice[1])
    for word in words:
        assert word in said, said
