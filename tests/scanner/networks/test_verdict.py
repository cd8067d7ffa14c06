from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.geometry import Matches, Pose, mapped
from calib.networks import Warps, estimate_network, joined
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network, stations
from scanner.networks.captures import Captures
from scanner.networks.solve import SolvedNetwork
from scanner.networks.verdict import verdict_on
from tests.support.findings import kinds_of, the_only


def solved_from(made: SyntheticNetwork, captures: Mapping[tuple[str, str], Matches]) -> SolvedNetwork:
    sizes = {name: each.size for name, each in made.devices.items()}
    estimate = estimate_network(captures, sizes)
    surfaces = {
        projector: joined(estimate, projector, {c: each for (c, p), each in captures.items() if p == projector})
        for projector in sorted({p for _, p in captures})
    }
    return SolvedNetwork(Captures({}, sizes), estimate, surfaces, 1.0, "baseline")


@pytest.mark.parametrize(("turned_px", "wavy", "grade"), [(0.0, 0.005, "good"), (1.0, 0.0, "refused")])
def test_a_camera_turned_between_two_projectors_is_reported(turned_px: float, wavy: float, grade: str) -> None:
    """Walls with waves of half a centimetre are not reported."""
    made = random_network(np.random.default_rng(1), 2, 2, RoomOptions(boxes=1, count=4_000, wavy=wavy))
    moved = made.captures["camera2", "projector2"]
    turned = replace(moved, camera_px=moved.camera_px + np.array([turned_px, 0.0]))

    verdict = verdict_on(solved_from(made, {**made.captures, ("camera2", "projector2"): turned}))

    assert verdict.grade == grade, verdict
    assert ("pair-contradicts" in kinds_of(verdict.findings)) == (grade == "refused")
    assert "keystone" not in verdict.advice


def test_the_device_whose_picture_is_warped_is_named() -> None:
    """One edge of it is 1 % shorter than the opposite one, and a homography takes a picture of it to a picture."""
    made = random_network(np.random.default_rng(1), 2, 2, RoomOptions(boxes=1, count=4_000))
    width, height = made.devices["camera1"].size
    to_middle = np.array([[1.0, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1]])
    keystone = np.linalg.inv(to_middle) @ np.array([[1.0, 0, 0], [0, 1, 0], [0, 0.01 / height, 1]]) @ to_middle
    captures = {
        pair: replace(each, camera_px=mapped(keystone, each.camera_px)) if pair[0] == "camera1" else each
        for pair, each in made.captures.items()
    }

    solved = solved_from(made, captures)
    (warp,) = solved.estimate.warps.alone
    of_projector = replace(solved.estimate, warps=Warps((replace(warp, name="projector2"),)))

    for name, remedy, shown in (
        ("camera1", "For camera1 turn off what its driver", solved),
        ("projector2", "For projector2 turn off keystone correction", replace(solved, estimate=of_projector)),
    ):
        verdict = verdict_on(shown)
        assert verdict.grade == "refused"
        assert f"The picture of {name} is warped" in verdict.headline
        assert 0.006 < the_only("warped-picture", verdict.findings).number("trapezoid_share") < 0.016
        assert verdict.advice.startswith(remedy)


def test_a_camera_that_was_moved_between_its_captures_is_refused() -> None:
    made = random_network(np.random.default_rng(3), 2, 1, RoomOptions(boxes=0, count=4_000))
    sizes = {name: each.size for name, each in made.devices.items()}
    estimate = replace(estimate_network(made.captures, sizes), warps=Warps(moved="camera2"))

    verdict = verdict_on(SolvedNetwork(Captures({}, sizes), estimate, {}, 1.0, "baseline"))

    assert verdict.grade == "refused"
    assert verdict.headline == "camera2 was moved between its captures."


def test_two_devices_in_one_place_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    apart = stations._poses

    def close(*args: Any) -> dict[str, Pose]:
        poses = apart(*args)
        beside = poses["camera1"].translation + np.array([0.03, 0.02, 0.0])
        return {**poses, "camera2": Pose(poses["camera1"].rotation, beside)}

    monkeypatch.setattr(stations, "_poses", close)
    made = random_network(np.random.default_rng(3), 2, 1, RoomOptions(boxes=1, count=15_000))

    verdict = verdict_on(solved_from(made, made.captures))

    assert "camera1 and camera2 stand almost in one place" in the_only("standing-alike", verdict.findings).message
    assert any("camera1 and camera2 stand almost in one place" in reason for reason in verdict.reasons)
