from dataclasses import replace

import numpy as np
import pytest

from calib.networks import estimate_network, joined
from calib.synthetic import RoomOptions, random_network
from scanner.networks.captures import Captures
from scanner.networks.solve import SolvedNetwork
from scanner.networks.verdict import verdict_on


@pytest.mark.parametrize(("turned_px", "grade"), [(0.0, "good"), (3.0, "refused")])
def test_a_camera_that_turned_between_two_projectors_is_told(turned_px: float, grade: str) -> None:
    made = random_network(np.random.default_rng(1), 2, 2, RoomOptions(boxes=2, count=15_000))
    moved = made.captures["camera2", "projector2"]
    matches = {
        **made.captures,
        ("camera2", "projector2"): replace(moved, camera_px=moved.camera_px + np.array([turned_px, 0.0])),
    }
    sizes = {name: each.size for name, each in made.devices.items()}
    estimate = estimate_network(matches, sizes)
    surfaces = {
        projector: joined(estimate, projector, {c: each for (c, p), each in matches.items() if p == projector})
        for projector in ("projector1", "projector2")
    }

    verdict = verdict_on(SolvedNetwork(Captures({}, sizes), estimate, surfaces, 1.0, "baseline"))

    assert verdict.grade == grade, verdict
    assert ("contradicts the others" in verdict.headline) == (grade == "refused")
