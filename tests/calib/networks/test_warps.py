"""Keystone: one parameter of a device; and sigmas contain what of it the captures do not exclude.

A device that was moved between its captures is told by name, and nothing else is taken for one.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Pose, Size
from calib.networks import NetworkEstimate, Warps, estimate_network
from calib.networks.network import Device
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network, with_turned_camera

OPTIONS = RoomOptions(boxes=2, count=10_000)
CHAIN = ("camera1", "projector1"), ("camera2", "projector1"), ("camera2", "projector2"), ("camera3", "projector2")
KEYSTONE = 0.01


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
    """Warps of all five pictures have 20 parameters, one move has 6; unturned, none is named (see waves below)."""
    made = random_network(np.random.default_rng(0), 3, 2, OPTIONS)
    made = replace(made, captures={pair: made.captures[pair] for pair in CHAIN})
    turned = with_turned_camera(made, ("camera2", "projector2"), a_degree(0))

    assert estimate_network(turned.captures, sizes_of(made)).warps == Warps(moved="camera2")


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


def test_a_keystone_is_one_parameter_whatever_the_lens() -> None:
    """The lower edge is shorter than the upper one by a share of the mean of both."""
    size = Size(1280, 800)
    lens = np.array([1000.0, 600, 760, -0.05, 0.01, 0, 0, 0])
    device = Device(lens, Pose(np.eye(3), np.zeros(3)), size)
    points = np.random.default_rng(0).uniform((-0.5, -0.7, 1), (0.6, 0.03, 1), (20, 3))
    square = device.pixels(points)[0]
    off = square - (np.array(size) - 1) / 2

    shown = replace(device, warp=np.array([0, 0, 0, KEYSTONE])).pixels(points)[0]

    np.testing.assert_allclose(shown - square + off, off / (1 + KEYSTONE * off[:, 1:] / size.height), atol=1e-9)


def with_keystone(made: SyntheticNetwork) -> SyntheticNetwork:
    size = np.array(made.devices["projector1"].size)
    captures = dict(made.captures)
    for pair, matches in made.captures.items():
        if pair[1] == "projector1":
            off = matches.projector_px - (size - 1) / 2
            shown = (size - 1) / 2 + off / (1 + KEYSTONE * off[:, 1:] / size[1])
            captures[pair] = replace(matches, projector_px=shown)
    return replace(made, captures=captures)


def focal_errors(estimate: NetworkEstimate, made: SyntheticNetwork) -> tuple[np.ndarray, np.ndarray]:
    """Relative ones of all devices, and the sigmas of these."""
    focals = [(estimate.device(name).lens[0], made.devices[name].focal_px[0]) for name in estimate.names]
    sigmas = np.array([estimate.sigmas(name)[0] for name in estimate.names])
    return np.abs([np.log(found / true) for found, true in focals]), sigmas


@pytest.mark.parametrize(("seed", "named"), [(6, []), (9, ["projector1"])])
def test_keystone_is_in_the_sigmas_or_named(seed: int, named: list[str]) -> None:
    """One camera and two projectors, of which one corrects 1 % of keystone; sigmas are 0.2 and 0.8 % without it."""
    made = with_keystone(random_network(np.random.default_rng(seed), 1, 2, RoomOptions(boxes=2, count=20_000)))

    estimate = estimate_network(made.captures, {name: device.size for name, device in made.devices.items()})

    off, sigma = focal_errors(estimate, made)
    assert [each.name for each in estimate.warps.alone] == named
    assert not estimate.warps.moved
    assert 0.003 < off.min() < off.max() < 0.02
    assert 0.3 < (off / sigma).min() < (off / sigma).max() < 2
    for each in estimate.warps.alone:
        assert 0.5 * KEYSTONE < each.trapezoid < 1.5 * KEYSTONE


def test_a_camera_that_was_moved_between_two_projectors_is_named() -> None:
    """Turned by one pixel."""
    made = random_network(np.random.default_rng(4), 1, 2, RoomOptions(boxes=1, count=5_000))
    sizes = {name: device.size for name, device in made.devices.items()}
    second = made.captures["camera1", "projector2"]
    turned = replace(second, camera_px=second.camera_px + np.array([1.0, 0.0]))

    estimate = estimate_network({**made.captures, ("camera1", "projector2"): turned}, sizes)

    assert estimate.warps == Warps(moved="camera1")
