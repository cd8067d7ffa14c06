import numpy as np

from calib.geometry import Pose, Size, rotation_about
from calib.networks.from_pairs import CalibratedPair
from calib.networks.network import Device, Network
from calib.refinement import SHARED, Knowledge, KnownRig, State

_SIZES = Size(1000, 800), Size(900, 600)
_LENS = np.array([1100.0, 490, 410, -0.05, 0.01, 2e-4, -1e-4, 0.001])
# log f, x_0, y_0, k1, k2, p1, p2, k3 of both, rotation, direction
_SIGMA = np.array([1e-3, 2, 2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-3] * 2 + [1e-3] * 5)


def made(rng: np.random.Generator) -> Network:
    poses = [Pose(rotation_about(rng.normal(0, 0.2, 3)), rng.normal(0, 1, 3)) for _ in range(3)]
    return Network(tuple(Device(_LENS, pose, _SIZES[k % 2]) for k, pose in enumerate(poses)), ())


def pair_in(network: Network, rng: np.random.Generator) -> CalibratedPair:
    """Devices 2 and 1, calibrated with some error."""
    pair = CalibratedPair(
        2, 1, KnownRig(State(_LENS, _LENS, Pose(np.eye(3), np.array([1.0, 0, 0]))), np.eye(21)), *[np.zeros(0)] * 2
    )
    state = pair.rig_in(network).moved(_SIGMA * rng.normal(0, 1, SHARED))
    knowledge = Knowledge(*_SIZES, (500.0, 400.0), 30.0, 0.0)
    return CalibratedPair.of(2, 1, KnownRig(state, np.diag(_SIGMA**2)), knowledge.prior(state))


def test_the_gradient_matches_the_cost() -> None:
    rng = np.random.default_rng(0)
    network = made(rng)
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
    pair = pair_in(made(rng), rng)
    prior = Knowledge(*_SIZES, (500.0, 400.0), 30.0, 0.0).prior(pair.rig.state)
    _, pull, curvature = prior.misfit(pair.rig.state.additive())

    np.testing.assert_allclose(pair.precision + np.diag(curvature), np.diag(_SIGMA**-2.0), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(pair.pull, -pull, atol=1e-12)
    assert curvature[1] > 0
