from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Plane, Pose, Size, project, rotation_about
from calib.networks.network import Device, Network
from calib.networks.raster import ImageRaster, label_map, read
from calib.networks.shared_points import SharedPoints
from calib.numerics import Floats

LENS = np.array([900.0, 500, 400, -0.05, 0.01, 2e-4, -1e-4, 0.001])
RASTER = ImageRaster(4, 20, 30)


def made(rng: np.random.Generator, noise_px: float) -> tuple[Network, SharedPoints]:
    """Points that the second of three devices shares with the others; some of them with only one."""
    poses = [Pose(rotation_about(rng.normal(0, 0.1, 3)), np.array([x, 0.1 * x, 0.2 * x * x])) for x in (0.0, 1.0, -0.8)]
    network = Network(
        tuple(Device(LENS * (1 + 0.05 * i), pose, Size(1000, 800)) for i, pose in enumerate(poses)),
        (Plane(np.array([0.0, 0, 1]), 4.0),),
    )
    points = rng.uniform((-1, -1, 3), (1, 1, 5), (80, 3))

    def seen(number: int) -> Floats:
        device = network.devices[number]
        return project(device.lens, device.pose.inverse() @ points)[0]

    others = np.stack([seen(0), seen(2)], axis=1) + rng.normal(0, noise_px, (80, 2, 2))
    variance = np.full((80, 2), noise_px**2)
    variance[:5, 1] = np.inf
    ahead = (poses[1].inverse() @ points)[:, 2]
    return network, SharedPoints(1, (0, 2), seen(1), others, variance, 1.1 * ahead)


@pytest.mark.parametrize("along", [(), (True, True), (False, True)])
def test_the_gradient_matches_the_cost(along: tuple[bool, ...]) -> None:
    """Distances from epipolar lines may be counted elsewhere, where two others see a point."""
    rng = np.random.default_rng(0)
    network, shared = made(rng, 0.5)
    if along:
        arrays = {name: getattr(shared, name)[5:] for name in ("pixels", "partner_pixels", "variance", "depths")}
        shared = replace(shared, **arrays, along=along)
        assert (shared.freedom == 3 - sum(along)).all()
    columns = shared.columns(network)
    term = shared.misfit(network)
    cost, gradient, information = term.cost, term.gradient, term.information

    assert 0.7 < cost / shared.freedom.sum() < 1.3
    scale = np.sqrt(np.diag(information))
    for at, column in enumerate(columns):
        step = np.zeros(network.size)
        step[column] = 1e-3 / scale[at]
        after, before = (shared.misfit(network.moved(sign * step)).cost for sign in (1, -1))
        assert (
            abs((after - before) / (4 * step[column]) - gradient[at])
            < (1e-2 if along else 1e-3) * np.abs(gradient / scale).max() * scale[at]
        )
    curvature = information[:, columns == 20][:, 0]
    assert curvature[columns == 20][0] > 0


def test_point_errors_match_their_variances() -> None:
    network, shared = made(np.random.default_rng(1), 0.2)

    relative, across = shared.relative(network)

    assert shared.freedom[:5].tolist() == [1] * 5
    assert 0.7 < np.median(relative) < 1.4
    assert 0.8 < np.std(across) < 1.2


def test_labels_spread_inside_a_plane_and_not_beyond_it() -> None:
    rng = np.random.default_rng(0)
    pixels = rng.uniform((-0.5, -0.5), (119.5, 79.5), (8000, 2))
    left, right = pixels[:, 0] < 40, pixels[:, 0] > 80  # between them nobody knows anything
    labels = np.where(left, 0, np.where(right, 3, -1)).astype(np.int32)

    told = label_map(RASTER, [(pixels[::2], labels[::2]), (pixels[1::2], labels[1::2])])

    assert (told[1:-1, :9] == 0).all()
    assert (told[1:-1, 21:] == 3).all()
    assert (told[:, 11:19] == -1).all()
    found = read(RASTER, told, np.array([[10.0, 10.0], [60.0, 40.0], [100.0, 70.0], [200.0, 10.0]]))
    assert found.tolist() == [0, -1, 3, -1]


def test_matches_where_two_planes_meet_stay_unlabelled() -> None:
    x, y = np.meshgrid(np.arange(120.0), np.arange(80.0))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    labels = np.where(pixels[:, 0] < 60, 1, 2).astype(np.int32)

    told = label_map(RASTER, [(pixels, labels)])

    assert (told[1:-1, :14] == 1).all()
    assert (told[:, 14:16] == -1).all()
    assert (told[1:-1, 16:] == 2).all()
    assert (label_map(RASTER, [(pixels[:3], labels[:3])]) == -1).all()
