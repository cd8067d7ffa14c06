"""Faces are found with a known principal point, which is far from the centre of a cropped picture."""

import numpy as np

from calib.plane_segmentation import find_faces
from hw.settings import SimulatedRigSettings
from hw.simulated import Label, place_room
from tests.support.whole_room import observed

CAMERA, PROJECTOR = (480, 270), (854, 480)


def test_with_a_known_principal_point_a_box_is_not_taken_for_a_wall() -> None:
    """The camera shows the upper two thirds of its sensor; rotated boxes stand in front of the corner."""
    room = place_room(SimulatedRigSettings(seed=15), CAMERA, PROJECTOR)
    seen = observed(room, np.random.default_rng(0), 0.05)
    point = seen.calibration.camera.principal_point_px
    assert abs(point[1] - (CAMERA[1] - 1) / 2) > 70
    found = find_faces(seen.matches, CAMERA, PROJECTOR, point).matches.face
    assert found is not None
    label = seen.scene.labels[seen.surface]
    assert 0.97 < np.mean(label[found >= 0] <= Label.FLOOR) <= 1
    for face in range(3):
        (mostly, share) = np.unique(label[found == face], return_counts=True)
        assert share.max() / share.sum() > 0.97, mostly
