from dataclasses import replace

import numpy as np

from calib.networks import estimate_network, joined
from calib.synthetic import RoomOptions, random_network

OPTIONS = RoomOptions(boxes=1, count=15_000)


def test_points_lie_on_the_walls_and_cameras_agree_within_noise() -> None:
    network = random_network(np.random.default_rng(3), 2, 1, OPTIONS)
    estimate = estimate_network(network.captures, {name: each.size for name, each in network.devices.items()})
    by_camera = {camera: matches for (camera, _), matches in network.captures.items()}

    surface = joined(estimate, "projector1", by_camera)

    several = surface.cameras == 2
    assert several.sum() > 300
    assert 1.0 < surface.gain < 2.0
    (disagreement,) = surface.disagreements
    assert 0.7 < disagreement.relative / disagreement.expected < 1.5
    distances = np.stack([surface.points[several] @ p.normal - p.offset for p in estimate.network.planes])
    on_a_face = np.abs(distances).min(axis=0)
    assert 0 < np.median(on_a_face) < 3 * np.median(surface.sigma[several])

    shifted = {**by_camera, "camera2": replace(by_camera["camera2"], camera_px=by_camera["camera2"].camera_px + 2.0)}
    (disagreement,) = joined(estimate, "projector1", shifted).disagreements
    assert disagreement.relative > 3 * disagreement.expected
