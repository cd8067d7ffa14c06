from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Matches, Pose, Size, rotation_about
from calib.networks import NetworkEstimate, estimate_from_pairs
from calib.networks.from_pairs import CalibratedPair
from calib.networks.network import Device, Network
from calib.numerics import Floats
from calib.refinement import SHARED, Knowledge, KnownRig, State, device_of
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network

_SIZES = Size(1000, 800), Size(900, 600)
_LENS = np.array([1100.0, 490, 410, -0.05, 0.01, 2e-4, -1e-4, 0.001])
# log f, x_0, y_0, k1, k2, p1, p2, k3 of both, rotation, direction
_SIGMA_OF_PAIRS = np.array([1e-3, 2, 2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-3] * 2 + [1e-3] * 5)
_SIGMA = np.array([1e-3, 1, 1, 5e-3, 5e-3, 3e-4, 3e-4, 5e-3] * 2 + [1e-3] * 5)
Pair = tuple[str, str]


def made_pair(rng: np.random.Generator) -> Network:
    poses = [Pose(rotation_about(rng.normal(0, 0.2, 3)), rng.normal(0, 1, 3)) for _ in range(3)]
    return Network(tuple(Device(_LENS, pose, _SIZES[k % 2]) for k, pose in enumerate(poses)), ())


def pair_in(network: Network, rng: np.random.Generator) -> CalibratedPair:
    """Devices 2 and 1, calibrated with some error."""
    pair = CalibratedPair(
        2, 1, KnownRig(State(_LENS, _LENS, Pose(np.eye(3), np.array([1.0, 0, 0]))), np.eye(21)), *[np.zeros(0)] * 2
    )
    state = pair.rig_in(network).moved(_SIGMA_OF_PAIRS * rng.normal(0, 1, SHARED))
    knowledge = Knowledge(*_SIZES, (500.0, 400.0), 30.0, 0.0)
    return CalibratedPair.of(2, 1, KnownRig(state, np.diag(_SIGMA_OF_PAIRS**2)), knowledge.prior(state))


def test_the_gradient_matches_the_cost() -> None:
    rng = np.random.default_rng(0)
    network = made_pair(rng)
    pair = pair_in(network, rng)
    columns = pair.columns(network)
    term = pair.misfit(network)
    gradient, information = term.gradient, term.information

    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    for at, column in enumerate(columns.tolist()):
        step = np.zeros(network.size)
        step[column] = 1e-4 / scale[at] if scale[at] > 1e-9 else 1e-6
        after, before = (pair.misfit(network.moved(sign * step)).cost for sign in (1, -1))
        slope = (after - before) / (4 * step[column])
        assert abs(slope - gradient[at]) < 1e-3 * np.abs(gradient / np.maximum(scale, 1)).max() * max(scale[at], 1)


def test_what_was_known_before_is_taken_out() -> None:
    rng = np.random.default_rng(1)
    pair = pair_in(made_pair(rng), rng)
    prior = Knowledge(*_SIZES, (500.0, 400.0), 30.0, 0.0).prior(pair.rig.state)
    _, pull, curvature = prior.misfit(pair.rig.state.additive())

    np.testing.assert_allclose(
        pair.precision + np.diag(curvature), np.diag(_SIGMA_OF_PAIRS**-2.0), rtol=1e-9, atol=1e-6
    )
    np.testing.assert_allclose(pair.pull, -pull, atol=1e-12)
    assert curvature[1] > 0


def made(seed: int, cameras: int = 2, projectors: int = 2) -> SyntheticNetwork:
    return random_network(np.random.default_rng(seed), cameras, projectors, RoomOptions(boxes=1, count=8_000))


def true_state(network: SyntheticNetwork, pair: Pair) -> State:
    camera, projector = pair
    pose = network.poses[projector].inverse() @ network.poses[camera]
    return State(device_of(network.devices[camera]), device_of(network.devices[projector]), pose.in_baselines)


def calibrated(
    network: SyntheticNetwork, pairs: Sequence[Pair], seed: int, sigma: Floats = _SIGMA
) -> dict[Pair, KnownRig]:
    """Pairs that were calibrated before something else, with errors."""
    rng = np.random.default_rng([seed, 1])
    return {
        pair: KnownRig(true_state(network, pair).moved(sigma * rng.normal(0, 1, SHARED)), np.diag(sigma**2))
        for pair in pairs
    }


def estimated(
    network: SyntheticNetwork,
    rigs: Mapping[Pair, KnownRig],
    captures: Mapping[Pair, Matches] | None = None,
) -> NetworkEstimate:
    """From one station of which no plane is known."""
    station = {pair: replace(matches, face=None) for pair, matches in (captures or network.captures).items()}
    sizes = {name: device.size for name, device in network.devices.items()}
    points = {
        camera: PrincipalPoint(((sizes[camera].width - 1) / 2, (sizes[camera].height - 1) / 2), 60.0)
        for camera, _ in network.captures
    }
    return estimate_from_pairs([station], rigs, sizes, points=points)


def errors(estimate: NetworkEstimate, network: SyntheticNetwork) -> tuple[Floats, Floats]:
    """Relative errors of focal lengths (D,), and those of lenses and places over their sigmas, (6 D - 3,)."""
    first, second = (network.poses[name] for name in estimate.seed)
    unit = np.linalg.norm(second.translation - first.translation)
    focals, relative = [], list[float]()
    for name in estimate.names:
        lens, sigma, true = estimate.device(name).lens, estimate.sigmas(name), network.devices[name]
        focals.append(np.log(lens[0] / true.focal_px[0]))
        relative += [focals[-1] / sigma[0], *((lens[1:3] - true.principal_point_px) / sigma[1:3])]
        if name != estimate.names[0]:
            off = estimate.device(name).pose.translation * unit - first.inverse() @ network.poses[name].translation
            relative += list(off / unit / sigma[11:])
    return np.abs(focals), np.array(relative)


def test_pairs_that_are_calibrated_one_by_one_make_a_network_and_each_other_better() -> None:
    focals, relative = list[float](), list[float]()
    for seed in range(2):
        network = made(seed)
        estimate = estimated(network, calibrated(network, [*network.captures], seed))
        assert set(estimate.names) == set(network.devices)
        assert all(estimate.sigmas(name)[0] < 0.9e-3 for name in estimate.names)
        own_focals, own = errors(estimate, network)
        focals.extend(own_focals)
        relative.extend(own)
    assert 1e-5 < np.median(focals) < 0.8e-3
    assert 0.6 < np.sqrt(np.mean(np.square(relative))) < 1.4


def test_devices_without_a_calibrated_pair_follow_by_shared_light() -> None:
    network = made(4)

    estimate = estimated(network, calibrated(network, [("camera1", "projector1")], 4))

    focals, relative = errors(estimate, network)
    assert set(estimate.names) == set(network.devices)
    assert 1e-6 < focals.max() < 5e-3
    assert 0.1 < np.sqrt(np.mean(relative**2)) < 2.0


def test_devices_that_share_nothing_are_named() -> None:
    network = made(5)
    captures = {pair: network.captures[pair] for pair in (("camera1", "projector1"), ("camera2", "projector2"))}

    with pytest.raises(RefusalError, match="camera2, projector2: not connected with camera1, projector1"):
        estimated(network, calibrated(network, [("camera1", "projector1")], 5), captures)


def test_a_pair_that_contradicts_the_others_shows_it() -> None:
    network = made(6, 2, 1)
    moved = network.captures["camera2", "projector1"]
    away = replace(moved, camera_px=moved.camera_px + np.array([0.0, 3.0]))
    rigs = calibrated(network, [*network.captures], 6, _SIGMA / 100)

    strains = [
        max(strain.across_px / strain.noise_px for strain in estimated(network, rigs, captures).strains.values())
        for captures in (network.captures, {**network.captures, ("camera2", "projector1"): away})
    ]

    assert 0.5 < strains[0] < 2.5
    assert strains[1] > 3


def test_a_pair_that_is_calibrated_wrongly_makes_sigmas_larger() -> None:
    network = made(0)
    rigs = calibrated(network, [*network.captures], 0)
    wrong = dict(rigs)
    last = "camera2", "projector2"
    wrong[last] = replace(rigs[last], state=rigs[last].state.moved(10 * _SIGMA * np.eye(SHARED)[0]))

    right, other = estimated(network, rigs), estimated(network, wrong)

    assert max(right.disagreements.values()) < 2 < other.disagreements[last]
    assert max(other.disagreements, key=other.disagreements.__getitem__) == last
    assert 1.2 < other.sigmas("camera1")[0] / right.sigmas("camera1")[0] < 10


def test_no_calibrated_pair_is_an_error() -> None:
    network = made(7, 2, 1)
    with pytest.raises(ValueError, match="needs one that is calibrated"):
        estimate_from_pairs([network.captures], {}, {name: Size(*d.size) for name, d in network.devices.items()})
