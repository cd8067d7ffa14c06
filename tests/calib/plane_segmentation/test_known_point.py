"""Faces are found with a known principal point, which is far from the centre of a cropped picture."""

import numpy as np
import pytest

from calib.geometry import Matches
from calib.plane_segmentation import find_faces
from hw.settings import SimulatedRigSettings
from hw.simulated.scene import Label
from hw.simulated.simulation import SimulatedRoom

CAMERA, PROJECTOR = (480, 270), (854, 480)


@pytest.fixture(scope="module")
def room() -> SimulatedRoom:
    """A camera that shows the upper two thirds of its sensor; rotated boxes stand in front of the corner."""
    return SimulatedRoom(SimulatedRigSettings(seed=15), CAMERA, PROJECTOR)


def test_with_a_known_principal_point_a_box_is_not_taken_for_a_wall(room: SimulatedRoom) -> None:
    truth, known = room.ground_truth(), room.calibration
    assert known is not None
    lit = np.isfinite(truth.projector_px).all(axis=-1)
    row, column = np.nonzero(lit)
    noise = np.random.default_rng(0).normal(0, 0.05, (len(row), 2))
    matches = Matches(
        np.stack([column, row], axis=1).astype(np.float64),
        truth.projector_px[lit] + noise,
        sigma_px=np.full(len(row), 0.07),
    )
    assert abs(known.camera.principal_point_px[1] - (CAMERA[1] - 1) / 2) > 70
    found = find_faces(matches, CAMERA, PROJECTOR, known.camera.principal_point_px).matches.face
    assert found is not None
    is_wall = truth.label[lit] <= Label.FLOOR
    assert 0.97 < np.mean(is_wall[found >= 0]) <= 1
    for face in range(3):
        (mostly, share) = np.unique(truth.label[lit][found == face], return_counts=True)
        assert share.max() / share.sum() > 0.97, mostly
