"""The best of many candidates is chosen: homographies, fundamental matrices, corners, with ground truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Matches, homogeneous
from calib.numerics import Floats
from calib.plane_segmentation import corner_hypotheses
from calib.plane_segmentation.faces import find_faces
from calib.plane_segmentation.fundamental_matrix import _best_candidate
from calib.plane_segmentation.plane_parallax import Lens, TwoView
from calib.plane_segmentation.surfels import make_surfels
from calib.refusal import RefusalError

HOMOGRAPHY = np.array([[0.9, 0.1, 0.05], [-0.08, 1.1, -0.02], [0.15, -0.1, 1.0]])
EPIPOLE = np.array([0.7, 0.2, 0.4])


def cross_matrix(v: Floats) -> Floats:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def changed(matrix: Floats, by: float) -> Floats:
    """The matrix, and copies with one entry changed each, (19, 3, 3), the true one in the middle."""
    steps = [sign * by * step.reshape(3, 3) for step in np.eye(9) for sign in (-1, 1)]
    return matrix + np.stack([*steps[:9], np.zeros((3, 3)), *steps[9:]])


def points(rng: np.random.Generator, parallax: float) -> tuple[Floats, Floats]:
    """x, u (400, 2), a fifth of them wrong, displaced from the homography towards the epipole by up to `parallax`."""
    x = rng.uniform(-1, 1, (400, 2))
    h = homogeneous(x) @ HOMOGRAPHY.T + parallax * rng.uniform(-1, 1, (400, 1)) * EPIPOLE
    u = h[:, :2] / h[:, 2:] + rng.normal(0, 1e-4, x.shape)
    u[:80] = rng.uniform(-1, 1, (80, 2))
    order = rng.permutation(400)
    return x[order], u[order]


@pytest.mark.parametrize("seed", range(5))
def test_the_true_homography_is_chosen(seed: int) -> None:
    x, u = points(np.random.default_rng(seed), 0.0)
    assert _best_candidate(changed(HOMOGRAPHY, 0.01), x, u, False) == 9


@pytest.mark.parametrize("seed", range(5))
def test_the_true_fundamental_matrix_is_chosen(seed: int) -> None:
    x, u = points(np.random.default_rng(seed), 0.3)
    assert _best_candidate(changed(cross_matrix(EPIPOLE) @ HOMOGRAPHY, 0.01), x, u, True) == 9


@pytest.mark.parametrize("angle_deg", [0.0, 0.8, 3.0, 45.0, 80.0, 88.5, 90.0, 91.2, 133.0, 179.0])
@pytest.mark.parametrize("focal", [0.6, 2.5])
def test_regular_angles_are_likelier_than_others(
    monkeypatch: pytest.MonkeyPatch, angle_deg: float, focal: float
) -> None:
    """An equal mixture of a uniform angle from 0° to 90°, and of 0° or 90° with a normal error."""
    sigma = 1.7
    monkeypatch.setattr(corner_hypotheses, "_ANGLE_SIGMA_DEG", sigma)
    one = np.array([0.6, -0.48, 0.64])
    across = np.cross(one, [0.8, 0.6, 0.0])
    across /= np.linalg.norm(across)
    normals = np.stack([one, np.cos(np.radians(angle_deg)) * one + np.sin(np.radians(angle_deg)) * across])
    at_infinity = np.array([[0.3, -0.2, 0.1]])
    planes = 2.0 * normals / np.array([focal, focal, 1.0]) + at_infinity
    found = corner_hypotheses._regularity(at_infinity, np.array([focal]), planes)[0]
    off = min(angle_deg % 90, 90 - angle_deg % 90)
    regular = np.sqrt(2 / np.pi) / sigma * np.exp(-((off / sigma) ** 2) / 2)  # folded: off is not negative
    assert found == pytest.approx(np.log((regular + 1 / 45) / 2), abs=1e-5)


def corner_before(focal: float, projector_focal: float) -> tuple[TwoView, Floats, list[Floats]]:
    """A square corner before two ideal devices: the geometry with some plane's homography as its base, the planes'
    parallaxes (3, 3) and points on them in homogeneous image coordinates.
    """
    camera, projector = np.diag([focal, focal, 1.0]), np.diag([projector_focal, projector_focal, 1.0])
    turn = Rotation.from_euler("xyz", [0.05, -0.15, 0.03]).as_matrix()
    epipole = projector @ np.array([0.3, 0.05, 0.06])
    legs = Rotation.from_euler("xyz", [0.9, 0.55, 0.2]).as_matrix().T  # of the corner, towards the camera
    legs *= -np.sign(legs[:, 2:])
    vertex = np.array([0.1, 0.05, 3.0])
    inverse_depth = legs / (legs @ vertex)[:, None] @ np.linalg.inv(camera)
    base = np.array([0.1, -0.05, 0.2])
    view = TwoView(
        Lens((2, 2)), Lens((2, 2)), projector @ turn @ np.linalg.inv(camera) + np.outer(epipole, base), epipole
    )
    spread = np.random.default_rng(0).uniform(0.05, 1, (2, 40, 1))
    points = [vertex + spread[0] * legs[face - 2] + spread[1] * legs[face - 1] for face in range(3)]
    return view, inverse_depth - base, [homogeneous((x / x[:, 2:])[:, :2]) @ camera for x in points]


@pytest.mark.parametrize(("focal", "projector_focal"), [(1.2, 1.2), (1.5, 2.9), (2.0, 2.2), (3.4, 1.8), (4.5, 3.0)])
def test_the_corner_fits_where_the_projectors_pixels_are_square(focal: float, projector_focal: float) -> None:
    view, planes, x = corner_before(focal, projector_focal)
    trials = corner_hypotheses._trials(view, planes, x, planes)
    assert trials is not None
    found = trials.likeliest(1e-4)  # no error of the planes is to be allowed for here
    assert found.focal == pytest.approx(focal, rel=0.025)  # 2.45 % from one trial to the next
    assert found.off_square < 3e-4
    np.testing.assert_allclose(found.at_infinity, [-0.1, 0.05, -0.2], atol=0.01)


def test_matches_smooth_in_few_places_are_refused() -> None:
    x, y = np.meshgrid(np.arange(450.0), np.arange(400.0))
    camera_px = np.stack([x.ravel(), y.ravel()], axis=1)
    scattered = np.random.default_rng(0).uniform(0, 200, camera_px.shape)
    smooth = np.all(camera_px < 110, axis=1)  # 7 % of the image
    matches = Matches(camera_px, np.where(smooth[:, None], 0.5 * camera_px, scattered))
    surfels = make_surfels(matches, (450, 400), np.random.default_rng(0))
    assert 60 < len(surfels) < 0.1 * surfels.tried
    with pytest.raises(RefusalError, match="not smooth"):
        find_faces(matches, (450, 400), (225, 200))
