"""A device that was moved between its captures is told by name, and nothing else is taken for one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Size
from calib.networks import Warps, estimate_network
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network, with_turned_camera

OPTIONS = RoomOptions(boxes=2, count=10_000)
CHAIN = ("camera1", "projector1"), ("camera2", "projector1"), ("camera2", "projector2"), ("camera3", "projector2")


def sizes_of(network: SyntheticNetwork) -> dict[str, Size]:
    return {name: device.size for name, device in network.devices.items()}


def a_degree(seed: int) -> np.ndarray:
    axis = np.random.default_rng([seed, 7]).normal(size=3)
    return np.radians(1.0) * axis / np.linalg.norm(axis)


# Of 0 no plane is let go first; of 2 one is, of 11 only three are seen.
@pytest.mark.parametrize("seed", [0, 2, 11])
def test_a_camera_that_was_turned_between_two_projectors_is_named(seed: int) -> None:
    made = random_network(np.random.default_rng(seed), 1, 2, OPTIONS)
    turned = with_turned_camera(made, ("camera1", "projector2"), a_degree(seed))

    estimate = estimate_network(turned.captures, sizes_of(made))

    assert estimate.warps == Warps(moved="camera1")


def test_a_camera_between_two_halves_of_five_devices_is_named() -> None:
    """Warps of all five pictures have 20 parameters, one move has 6."""
    made = random_network(np.random.default_rng(0), 3, 2, OPTIONS)
    made = replace(made, captures={pair: made.captures[pair] for pair in CHAIN})
    turned = with_turned_camera(made, ("camera2", "projector2"), a_degree(0))

    assert estimate_network(turned.captures, sizes_of(made)).warps == Warps(moved="camera2")
    assert not estimate_network(made.captures, sizes_of(made)).warps


def test_a_projector_that_was_turned_between_two_cameras_is_named() -> None:
    made = random_network(np.random.default_rng(5), 2, 1, OPTIONS)
    pair, projector = ("camera2", "projector1"), made.devices["projector1"]
    matches = made.captures[pair]
    rays = projector.unproject(matches.projector_px)
    turned = projector.project(Rotation.from_rotvec(a_degree(5)).apply(rays))

    estimate = estimate_network({**made.captures, pair: replace(matches, projector_px=turned)}, sizes_of(made))

    assert estimate.warps.moved in ("projector1", "camera2")
    assert not estimate.warps.alone


@pytest.mark.parametrize(("seed", "cameras", "projectors"), [(6, 1, 2), (1, 3, 2)])
def test_walls_with_waves_are_no_move(seed: int, cameras: int, projectors: int) -> None:
    made = random_network(np.random.default_rng(seed), cameras, projectors, replace(OPTIONS, count=40_000, wavy=0.002))
    captures = {pair: made.captures[pair] for pair in CHAIN} if cameras == 3 else made.captures

    assert not estimate_network(captures, sizes_of(made)).warps
