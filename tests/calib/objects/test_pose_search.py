"""One view of a thing is laid on another without an initial guess."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Intrinsics, Pose
from calib.numerics import Floats
from calib.objects import view_of
from calib.objects.pose_search import normal_centre, searched_poses
from calib.objects.view import ObjectView
from calib.registration import even_rotations

SIDE, FOCAL, CENTRE = 160, 300.0, np.array([0.05, -0.03, 3.0])
RADII = np.array([0.55, 0.4, 0.28])
# An ellipsoid is the same after half a turn about any of its axes.
ALIKE = [np.diag(signs) for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]


def ellipsoid(turn: Floats) -> ObjectView:
    """As it is seen with its axes turned (3, 3); the depth along a ray r solves |A (t r − c)| = 1."""
    row, column = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    rays = np.stack([column / FOCAL, row / FOCAL, np.ones_like(row)], axis=-1)
    unit = turn.T / RADII[:, None]
    along, beside = rays @ unit.T, unit @ CENTRE
    a, b, c = np.sum(along**2, axis=-1), along @ beside, beside @ beside - 1
    t = np.where(b**2 > a * c, (b - np.sqrt(np.maximum(b**2 - a * c, 0))) / a, np.nan)
    points = t[..., None] * rays
    normals = (points - CENTRE) @ unit.T @ unit
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    camera = Intrinsics(SIDE, SIDE, (FOCAL, FOCAL), ((SIDE - 1) / 2, (SIDE - 1) / 2))
    view = view_of(points.astype(np.float32), normals.astype(np.float32), camera)
    assert view is not None
    return view


@pytest.mark.parametrize("degrees", [(0, 25, 0), (20, -15, 70), (-30, 0, 160)])
def test_the_pose_of_a_turned_thing_is_found(degrees: tuple[float, float, float]) -> None:
    start = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
    turn = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    first, second = ellipsoid(start), ellipsoid(turn @ start)
    true = [
        Pose(rotation, CENTRE - rotation @ CENTRE) for rotation in (start @ same @ start.T @ turn.T for same in ALIKE)
    ]
    (best, *_) = searched_poses(first, second, 4, 20)
    off = [pose.inverse() @ best for pose in true]
    turned = [float(np.linalg.norm(Rotation.from_matrix(pose.rotation).as_rotvec())) for pose in off]
    nearest = int(np.argmin(turned))
    assert 0 < np.degrees(turned[nearest]) < 0.4
    assert np.linalg.norm(best @ CENTRE - CENTRE) < 0.08 * first.grain


def test_normals_of_a_round_thing_meet_in_its_middle() -> None:
    view = ellipsoid(np.eye(3))
    assert np.linalg.norm(normal_centre(view) - CENTRE) < RADII.max() / 2
    assert normal_centre(view)[2] > view.patches.points[:, 2].max() - RADII.min() / 2


def test_no_rotation_is_far_from_the_even_ones() -> None:
    turns = even_rotations(1200)
    asked = Rotation.random(300, rng=np.random.default_rng(0)).as_matrix()
    cosine = (np.einsum("nij,kij->nk", asked, turns).max(axis=1) - 1) / 2
    farthest = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert 10 < farthest.max() < 20
    assert np.abs(np.einsum("kij,klj->kil", turns, turns) - np.eye(3)).max() < 1e-12
