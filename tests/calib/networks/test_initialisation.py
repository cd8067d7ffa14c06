"""Matches of a pair get the labels that others tell; devices are placed one after the other."""

from dataclasses import replace

import numpy as np
import pytest

from calib.estimation import Cells
from calib.geometry import IDENTITY, NO_FACE, Matches, Plane, Pose, Size, rotation_about
from calib.networks.initialisation import Grown, placed
from calib.networks.network import Device, Network
from calib.networks.observations import Overlaps, PlaneObservation
from calib.networks.prior import NetworkKnowledge
from calib.refinement import device_of
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network

PAIR = ("camera1", "projector1")


@pytest.fixture(scope="module")
def network() -> SyntheticNetwork:
    return random_network(np.random.default_rng(3), 1, 1, RoomOptions(boxes=0, count=3000))


def _grown(network: SyntheticNetwork, told: Matches) -> Grown:
    """Both devices where they are, three planes, and the matches' labels as far as they are told."""
    camera, projector = (network.devices[name] for name in PAIR)
    into_camera = network.poses[PAIR[0]].inverse()
    devices = (
        Device(device_of(camera), IDENTITY, camera.size),
        Device(device_of(projector), into_camera @ network.poses[PAIR[1]], projector.size),
    )
    sizes = {name: device.size for name, device in network.devices.items()}
    normals, offsets = network.planes
    planes = tuple(
        Plane(into_camera.rotation @ normal, float(offset + (into_camera.rotation @ normal) @ into_camera.translation))
        for normal, offset in zip(normals[:3], offsets[:3], strict=True)
    )
    return Grown(
        PAIR,
        Network(devices, planes),
        {PAIR: told},
        (),
        network.captures,
        Overlaps.of(network.captures, sizes),
        NetworkKnowledge(sizes, frozenset(PAIR[:1])),
    )


@pytest.mark.parametrize(("wrong", "is_told"), [(0.0, True), (0.06, True), (0.14, False), (0.5, False)])
def test_the_rest_of_a_face_is_on_the_plane_that_nearly_all_of_it_is_on(
    network: SyntheticNetwork, wrong: float, is_told: bool
) -> None:
    """Of half of the matches on the first face others tell the plane, and of a share of these another one."""
    matches = network.captures[PAIR]
    assert matches.face is not None
    on = np.flatnonzero(matches.face == 0)
    known, rest = on[::2], on[1::2]
    labels = np.full(len(matches), NO_FACE, np.int32)
    labels[known] = 0
    labels[known[: round(wrong * len(known))]] = 1
    told = replace(matches, face=labels)

    grown = _grown(network, told)._with_pair(PAIR)

    assert len(grown.network.planes) == 3
    assert (grown.labelled[PAIR].labels[rest] == (0 if is_told else NO_FACE)).all()
    np.testing.assert_array_equal(grown.labelled[PAIR].labels[known], labels[known])


def test_the_jacobian_matches_the_prediction() -> None:
    rng = np.random.default_rng(0)
    lens = np.array([900.0, 500, 400, -0.05, 0.01, 2e-4, -1e-4, 0.001])
    at, light = (Pose(rotation_about(rng.normal(0, 0.2, 3)), np.array([x, 0.1, -0.2])) for x in (0.2, 1.0))
    camera = Device(lens, at, Size(1000, 800), np.array([0.1, -0.2, 0.15, -0.1]))
    projector = Device(1.1 * lens, light, Size(1000, 800), np.array([-0.1, 0.2, 0.1, 0.2]))
    plane = Plane(np.array([0.1, 0.2, -1.0]) / np.sqrt(1.05), -4.0)
    network = Network((projector, camera), (Plane(np.array([1.0, 0, 0]), -5.0), plane))
    pixels = rng.uniform((100, 100), (900, 700), (20, 2))
    cells = Cells(pixels, pixels, np.ones(20, np.int32), np.ones(20), np.ones(20), 1.0, 0.0)
    sight = PlaneObservation(0, 1, 0, 1, cells)

    _, jacobian, depths = sight.predict(network)

    assert (depths > 1).all()
    for place, column in enumerate(sight.columns(network)):
        step = np.zeros(network.size)
        step[column] = 1e-6
        after, before = (sight.predict(network.moved(sign * step))[0] for sign in (1, -1))
        slope = (after - before) / 2e-6
        assert np.abs(jacobian[:, :, place] - slope).max() < 1e-4 * max(1.0, np.abs(slope).max())


def test_a_device_is_placed_by_points_on_two_planes_and_not_by_one() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 1, (60, 3))
    points[:30, 0], points[30:, 1] = 0.0, 0.0
    pose = Pose(rotation_about(np.array([2.2, 0.3, 0.1])), np.array([1.5, 2.0, 3.5]))
    before = pose.inverse() @ points
    pixels = 800 * before[:, :2] / before[:, 2:] + (320, 240)
    assert (before[:, 2] > 0).all() or (before[:, 2] < 0).all()

    device = placed(points, pixels, Size(640, 480))

    assert device is not None
    np.testing.assert_allclose(device.lens[:3], [800, 320, 240], rtol=1e-5)
    np.testing.assert_allclose(device.pose.translation, pose.translation, rtol=1e-5)
    assert placed(points[:30], pixels[:30], Size(640, 480)) is None
