import numpy as np

from calib.estimation import Cells
from calib.geometry import Plane, Pose, Size, rotation_about
from calib.networks.initialisation import placed
from calib.networks.network import Device, Network
from calib.networks.observations import PlaneObservation


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
