from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Size
from calib.networks import NetworkEstimate, estimate_network
from calib.numerics import Floats
from calib.refusal import RefusalError
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network

OPTIONS = RoomOptions(boxes=1, count=15_000)


def sizes_of(network: SyntheticNetwork) -> dict[str, Size]:
    return {name: device.size for name, device in network.devices.items()}


def errors(estimate: NetworkEstimate, network: SyntheticNetwork) -> tuple[Floats, Floats, Floats]:
    """Of focals (devices,), relative; of places (devices,) in metres; and both over their sigmas, (4 devices − 4,)."""
    first, second = (network.poses[name] for name in estimate.seed)
    unit = np.linalg.norm(second.translation - first.translation)
    focals, places, relative = [], [], []
    for name in estimate.names:
        device, sigma = estimate.device(name), estimate.sigmas(name)
        focals.append(np.log(device.lens[0] / network.devices[name].focal_px[0]))
        relative.append(focals[-1] / sigma[0])
        true = first.rotation.T @ (network.poses[name].translation - first.translation)
        off = device.pose.translation * unit - true
        places.append(np.linalg.norm(off))
        if name != estimate.names[0]:
            relative.extend(off / unit / sigma[11:])
    return np.abs(focals), np.array(places), np.array(relative)


def without_faces_but(network: SyntheticNetwork, pair: tuple[str, str]) -> SyntheticNetwork:
    """Only one pair has labels, so the others have to find theirs."""
    captures = {
        each: matches if each == pair else matches.with_faces(np.full(len(matches), -1, np.int32))
        for each, matches in network.captures.items()
    }
    return replace(network, captures=captures)


@pytest.mark.parametrize(("cameras", "projectors", "focal", "place_m"), [(2, 1, 1e-2, 1e-2), (2, 2, 4e-3, 5e-3)])
def test_all_devices_follow_from_one_corner(cameras: int, projectors: int, focal: float, place_m: float) -> None:
    made = random_network(np.random.default_rng(3), cameras, projectors, OPTIONS)
    network = without_faces_but(made, ("camera1", "projector1"))

    estimate = estimate_network(network.captures, sizes_of(network))

    focals, places, relative = errors(estimate, network)
    assert set(estimate.names) == set(network.devices)
    assert 0 < focals.max() < focal
    assert 0 < places.max() < place_m
    assert 0.05 < np.sqrt(np.mean(relative**2)) < 2.2  # errors of one network go together


def test_a_device_that_shares_no_light_is_named() -> None:
    made = random_network(np.random.default_rng(3), 2, 2, OPTIONS)
    apart = {pair: made.captures[pair] for pair in (("camera1", "projector1"), ("camera2", "projector2"))}

    with pytest.raises(RefusalError, match=r"^camera(.), projector\1: not connected with camera(.), projector\2\."):
        estimate_network(apart, sizes_of(made))


def test_what_cannot_be_a_network_is_told() -> None:
    made = random_network(np.random.default_rng(3), 2, 1, OPTIONS)
    first, second = made.captures.values()

    with pytest.raises(ValueError, match="needs two pairs"):
        estimate_network({("a", "b"): first}, sizes_of(made))
    with pytest.raises(ValueError, match="'b' is the name of a camera and of a projector"):
        estimate_network({("a", "b"): first, ("b", "c"): second}, sizes_of(made))
    with pytest.raises(ValueError, match="'a' has no image size"):
        estimate_network({("a", "p"): first, ("b", "p"): second}, {"b": Size(4, 3), "p": Size(4, 3)})
