"""Matches of a pair get the labels that others tell."""

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import IDENTITY, NO_FACE, Matches, Plane
from calib.networks.initialisation import Grown
from calib.networks.network import Device, Network
from calib.networks.observations import Overlaps
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
