"""What a view says of a patch at a supposed place: on its surface, off it, hidden, in free space before it, unseen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Intrinsics, Pose
from calib.numerics import Floats
from calib.objects.patch_overlap import overlapping_pixels
from calib.objects.view import ObjectView
from calib.registration import (
    HIDDEN,
    OFF_SURFACE,
    THROUGH_FREE_SPACE,
    UNSEEN,
    Patches,
    RangeImage,
    no_keypoints,
)

WIDTH, HEIGHT, FOCAL = 80, 60, 100.0
SURFACE, BACKGROUND = 2.0, 3.0  # depths of a plane in the middle of the picture, and of the wall behind it
GRAIN, WITHIN = 0.04, 0.01
POSE = Pose(Rotation.from_euler("xyz", [20, -30, 40], degrees=True).as_matrix(), np.array([0.3, -0.2, 0.5]))


@pytest.fixture(scope="module")
def view() -> ObjectView:
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    is_thing = (abs(row - 30) < 15) & (abs(column - 40) < 20)
    rays = np.stack([(column - 40) / FOCAL, (row - 30) / FOCAL, np.ones(row.shape)], axis=-1)
    points = np.where(is_thing[..., None], SURFACE * rays, np.nan).astype(np.float32)
    normals = np.where(is_thing[..., None], [0.0, 0.0, -1.0], np.nan).astype(np.float32)
    depth = np.where(is_thing, SURFACE, BACKGROUND).astype(np.float32)
    depth[:, :10] = 0  # where nothing is known
    camera = Intrinsics(WIDTH, HEIGHT, (FOCAL, FOCAL), (40.0, 30.0))
    lens = np.array([FOCAL, FOCAL, 40.0, 30.0, 0, 0, 0, 0, 0])
    image = RangeImage(points, normals, depth, depth, lens)
    return ObjectView(image, camera, np.flatnonzero(is_thing), 1e-4, GRAIN, no_keypoints())


def at(column: float, row: float, depth: float) -> Floats:
    """A point (3,) on the ray of a pixel."""
    return depth * np.array([(column - 40) / FOCAL, (row - 30) / FOCAL, 1.0])


def turned(degrees: float) -> Floats:
    """The surface's normal, turned to the right."""
    return np.array([np.sin(np.radians(degrees)), 0.0, -np.cos(np.radians(degrees))])


@pytest.mark.parametrize(
    ("point", "normal", "expected"),
    [
        (at(40, 30, SURFACE), turned(0), 30 * WIDTH + 40),
        (at(25, 42, SURFACE), turned(0), 42 * WIDTH + 25),
        (at(31, 21, SURFACE + 0.9 * WITHIN), turned(0), 21 * WIDTH + 31),
        (at(31, 21, SURFACE - 0.9 * WITHIN), turned(35), 21 * WIDTH + 31),
        (at(31, 21, SURFACE + 1.1 * WITHIN), turned(0), OFF_SURFACE),
        (at(31, 21, SURFACE - 1.1 * WITHIN), turned(0), OFF_SURFACE),
        (at(31, 21, SURFACE), turned(45), OFF_SURFACE),
        (at(31, 21, SURFACE - 1.4 * GRAIN), turned(0), OFF_SURFACE),
        (at(31, 21, SURFACE - 1.6 * GRAIN), turned(0), THROUGH_FREE_SPACE),
        (at(70, 30, BACKGROUND - 1.6 * GRAIN), turned(0), THROUGH_FREE_SPACE),
        (at(70, 30, BACKGROUND - 1.4 * GRAIN), turned(0), UNSEEN),
        (at(31, 21, SURFACE + 1.6 * GRAIN), turned(0), HIDDEN),
        (at(70, 30, BACKGROUND + 0.1), turned(0), HIDDEN),
        (at(40, 30, SURFACE), turned(180), UNSEEN),
        (at(31, 21, 1.0), turned(180), UNSEEN),
        (at(5, 30, 1.0), turned(0), UNSEEN),
        (at(-3, 30, SURFACE), turned(0), UNSEEN),
        (at(40, HEIGHT + 2, SURFACE), turned(0), UNSEEN),
        (at(40, 30, -SURFACE), turned(0), UNSEEN),
    ],
)
def test_a_patch_is_where_its_place_says(view: ObjectView, point: Floats, normal: Floats, expected: int) -> None:
    """In the frame of another view, from which the pose leads to this one."""
    back = POSE.inverse()
    patch = Patches((back @ point)[None], (back.rotation @ normal)[None])
    assert overlapping_pixels(patch, view, POSE, WITHIN).tolist() == [expected]
