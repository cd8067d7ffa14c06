"""Picking points and measuring, compared with the scene of the cloud."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.geometry import Calibration
from scanner.configuration import ScaleSettings
from scanner.measuring import DistanceMeasurement, PointNumber
from scanner.viewing.clicking import Picked, point_at, scale_from
from scanner.viewing.result import CaptureCloud
from tests.support.result_folder import Written


def test_a_ray_through_a_point_picks_it(cloud: CaptureCloud) -> None:
    random = np.random.default_rng(0)
    eye = np.array([0.3, -0.2, -0.5])
    for number in random.integers(0, len(cloud.points), 50):
        direction = cloud.points[number] - eye
        found = point_at(cloud.points, eye, 7.0 * direction)
        assert found is not None
        # What is seen from there is this point, or one before it that hides it.
        depth = np.linalg.norm(cloud.points[found] - eye) / np.linalg.norm(direction)
        assert found == number or depth < 0.99


def test_a_ray_past_all_points_picks_nothing(cloud: CaptureCloud) -> None:
    assert point_at(cloud.points, np.zeros(3), np.array([0.0, 0.0, -1.0])) is None
    assert point_at(cloud.points[:0], np.zeros(3), np.array([0.0, 0.0, 1.0])) is None


def test_the_uncertainty_of_the_old_scale_is_no_part_of_the_new_one() -> None:
    """Of 0.05 on a distance of 2 are 0.04 of the scale: 0.03 is left, 1.5 %; with 2 % of the known length, 2.5 %."""
    budget = SimpleNamespace(sigma=0.05, scale=0.04)
    distance = cast(DistanceMeasurement, SimpleNamespace(distance=2.0, budget=budget))
    calibration = cast(Calibration, SimpleNamespace(baseline=0.8))
    exact, known = (scale_from(distance, calibration, 1.5, sigma_m) for sigma_m in (0.0, 0.03))
    assert exact is not None
    assert known is not None
    assert exact.baseline_m == known.baseline_m == pytest.approx(0.6)
    assert exact.sigma_m == pytest.approx(0.015 * 0.6)
    assert known.sigma_m == pytest.approx(0.025 * 0.6)


def picked_points(cloud: CaptureCloud, *numbers: int) -> Picked:
    assert cloud.scans is not None
    picked = Picked(cloud.scans)
    for number in numbers:
        picked = picked.with_point(cloud.point_number(number))
    return picked


def _true_points(written: Written, cloud: CaptureCloud) -> np.ndarray:
    grid = np.full((*written.scene.texture.shape[:2], 3), np.nan)
    column, row = np.rint(written.scene.matches.camera_px).astype(int).T
    grid[row, column] = written.scene.points
    return grid[cloud.scan.pixel[:, 1], cloud.scan.pixel[:, 0]]


def _some(cloud: CaptureCloud, count: int) -> np.ndarray:
    """Widely spread points of faces, by number."""
    on_faces = np.flatnonzero(np.asarray(cloud.matches.face) >= 0)
    return np.random.default_rng(1).choice(on_faces, (100, count))


def test_angle_errors_match_their_sigmas(written: Written, cloud: CaptureCloud) -> None:
    true = _true_points(written, cloud)
    errors = []
    for first, second, third in _some(cloud, 3):
        picked = picked_points(cloud, first, second, third)
        angle, sigma = (
            float(word.strip("°*").replace("−", "-")) for word in picked.text().split() if word[0] in "*0123456789"
        )
        a, b = true[first] - true[second], true[third] - true[second]
        truth = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
        errors.append((angle - truth) / sigma)
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_two_points_give_a_distance_with_its_sigma(written: Written, cloud: CaptureCloud) -> None:
    true = _true_points(written, cloud)
    errors = []
    for first, second in _some(cloud, 2):
        words = picked_points(cloud, first, second).text().strip("*").split()
        assert (words[0], words[2], words[4]) == ("Distance:", "±", "mm")
        truth = 1000 * np.linalg.norm(true[first] - true[second])
        errors.append((float(words[1].strip("*")) - truth) / float(words[3]))
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_a_known_distance_gives_the_baseline_with_its_sigma(written: Written, cloud: CaptureCloud) -> None:
    """For any current scale of the result: the baseline is in the scene's metres."""
    true, baseline_m = _true_points(written, cloud), written.scene.calibration.baseline
    sigmas = []
    for first, second in _some(cloud, 2):
        length_m = float(np.linalg.norm(true[first] - true[second]))
        scale = picked_points(cloud, first, second).scale(length_m, 0.0)
        if scale is None:
            assert length_m < 0.05
            continue
        sigmas.append((scale.baseline_m - baseline_m) / scale.sigma_m)
        assert ScaleSettings.model_validate({key.partition(".")[2]: value for key, value in scale.keys.items()})
    assert 0.8 < np.sqrt(np.mean(np.square(sigmas))) < 1.25
    first, second = _some(cloud, 2)[0]
    picked = picked_points(cloud, first, second)
    sure, unsure = picked.scale(1.0, 0.0), picked.scale(1.0, 0.01)
    assert sure is not None
    assert unsure is not None
    assert unsure.sigma_m == pytest.approx(np.hypot(sure.sigma_m, 0.01 * sure.baseline_m))
    assert picked.scale(1.0, 0.3) is None


def test_a_fourth_point_starts_a_new_measurement(cloud: CaptureCloud) -> None:
    picked = picked_points(cloud)
    assert picked.text().startswith("Click on a point")
    assert picked.places.shape == (0, 3)
    for number, expected in ((5, (5,)), (9, (5, 9)), (70, (5, 9, 70)), (11, (11,)), (12, (11, 12)), (11, (11,))):
        picked = picked.with_point(PointNumber(0, number))
        assert tuple(number.point for number in picked.points) == expected
    assert picked.text().startswith("Pixel (")
    assert picked.places.shape == (1, 3)
