"""The size of a board of known points from its matches, with a true sigma."""

import numpy as np
import pytest

from calib.diagnostics import moved_calibration, size_of_sheet
from calib.geometry import Calibration, Matches, Pose
from calib.numerics import Floats
from calib.refinement import SHARED
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, look_at
from tests.support.known_rigs import before

ROTATION = look_at(np.array([0.4, 0.0, 0.0]), np.array([0.0, 0.1, 2.0]), np.array([0.0, -1.0, 0.0]))
RIG = Calibration(PAPER_CAMERA, PAPER_PROJECTOR, Pose(ROTATION, -ROTATION @ np.array([0.4, 0.0, 0.0])), "m")


def seen(rng: np.random.Generator, rig: Calibration, distance: float, px: float) -> tuple[Floats, Floats, Matches]:
    """Points of a board in metres, their pixels with a tenth of the noise, and matches on the board."""
    column, row = np.meshgrid(np.arange(7.0), np.arange(5.0))
    points = 0.03 * np.stack([column.ravel() - 3, row.ravel() - 2], axis=1)
    turn = look_at(np.zeros(3), np.array([0.3, 0.8, 1.0]), np.array([0.0, -1.0, 0.0])).T
    middle = np.array([0.0, 0.05 * distance, distance])

    def placed(on_sheet: Floats) -> Floats:
        return on_sheet @ turn[:, :2].T + middle

    spread = placed(rng.uniform(-0.1, 0.1, (4000, 2)))
    projected = rig.projector.project(rig.pose @ spread)
    matches = Matches(rig.camera.project(spread), projected + rng.normal(0, px, projected.shape))
    return points, rig.camera.project(placed(points)) + rng.normal(0, px / 2, points.shape), matches


def test_errors_are_within_the_stated_noise() -> None:
    errors = []
    for seed in range(30):
        found = size_of_sheet(*seen(np.random.default_rng(seed), RIG, 2.0, 0.1), RIG, None)
        assert 1e-5 < found.noise < 3e-3
        errors.append(found.log_length / found.noise)
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.3


@pytest.mark.xdist_group("boards and corner")
def test_the_scale_changes_with_the_calibration_as_predicted() -> None:
    case = before(1)
    rig, uncertainty = case.known.calibration, case.known.uncertainty
    sheet = seen(np.random.default_rng(0), rig, 0.9, 0.05)
    found = size_of_sheet(*sheet, rig, uncertainty)
    root = np.linalg.cholesky(uncertainty.covariance + 1e-16 * np.eye(SHARED))
    step = root @ np.random.default_rng(2).normal(size=SHARED)
    moved = size_of_sheet(*sheet, moved_calibration(rig, uncertainty, step), None)
    expected = float(found.by_columns @ step)
    assert abs(expected) > 1e-5
    assert moved.log_length - found.log_length == pytest.approx(expected, rel=0.1, abs=2e-6)


def test_matches_behind_the_devices_are_refused() -> None:
    turned_round = RIG.scaled(-1.0)
    with pytest.raises(ValueError, match="not in front"):
        size_of_sheet(*seen(np.random.default_rng(0), RIG, 2.0, 0.1), turned_round, None)
