"""The cloud of a network, in the colours of any camera."""

import numpy as np
import pytest

from calib.geometry import Size
from calib.networks import NetworkEstimate, estimate_network, joined
from calib.numerics import Image
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network
from scanner.capture import CaptureMetadata
from scanner.networks.captures import Captures
from scanner.networks.save import cloud_of
from scanner.networks.solve import SolvedNetwork
from scanner.results import Decoded, GivenMatches

pytestmark = pytest.mark.xdist_group("network cloud")  # what the module shares is made once

Estimated = tuple[SyntheticNetwork, dict[str, Size], NetworkEstimate]


@pytest.fixture(scope="module")
def estimated() -> Estimated:
    made = random_network(np.random.default_rng(1), 2, 1, RoomOptions(boxes=1, count=6000))
    sizes = {name: each.size for name, each in made.devices.items()}
    return made, sizes, estimate_network(made.captures, sizes)


@pytest.mark.parametrize(
    ("level", "kind", "rgb"),
    [
        ((10, 60, 200), np.uint8, (200, 60, 10)),  # BGR, as the cameras give it
        ((1000, 2000, 4000), np.uint16, (255, 128, 64)),
        (90, np.uint8, (90, 90, 90)),
    ],
)
def test_a_cloud_has_the_colours_of_its_cameras(
    estimated: Estimated, level: tuple[int, int, int] | int, kind: type, rgb: tuple[int, int, int]
) -> None:
    made, sizes, estimate = estimated
    decoded = {}
    for (camera, projector), matches in made.captures.items():
        width, height = sizes[camera]
        picture: Image = np.broadcast_to(np.array(level, kind), (height, width, *np.shape(level))).copy()
        metadata = CaptureMetadata(sizes[camera], sizes[projector])
        decoded[camera, projector] = Decoded(metadata, matches, GivenMatches(picture))
    light = {camera: matches for (camera, _), matches in made.captures.items()}
    surfaces = {"projector1": joined(estimate, "projector1", light)}

    cloud = cloud_of(SolvedNetwork(Captures(decoded, sizes), estimate, surfaces, 1.0, "baseline"))

    assert 500 < len(cloud.points) < 400 * 250
    assert tuple(np.median(cloud.colours, axis=0)) == rgb
