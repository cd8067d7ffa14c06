"""Planes beside the corner constrain it if they are perpendicular to it, and are left out otherwise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Matches
from calib.self_calibration import PrincipalPoint, SelfCalibration, self_calibrate
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, SyntheticCapture, random_capture

KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)


def _with_planes(
    capture: SyntheticCapture, heights: tuple[float, ...], tilt_deg: float, rng: np.random.Generator
) -> tuple[Matches, np.ndarray]:
    """The capture with a share of each face's matches moved to a plane in front of it, and the plane of each match."""
    matches, truth = capture.matches, capture.calibration
    face, plane = matches.face.copy(), matches.face.copy()
    projector_px = matches.projector_px.copy()
    rays = truth.camera.unproject(matches.camera_px)
    for i, height in enumerate(heights):
        chosen = np.flatnonzero((matches.face == i) & (rng.random(len(face)) < 0.3))
        tilt = Rotation.from_rotvec(
            np.radians(tilt_deg / 2) * (capture.corner.legs.sum(axis=0) - capture.corner.legs[i])
        ).as_matrix()
        normal = tilt @ capture.corner.normals[i]
        depth = (normal @ capture.corner.vertex + height) / (rays[chosen] @ normal)
        points = rays[chosen] * depth[:, None]
        ideal = truth.projector.project(truth.pose @ points)
        projector_px[chosen] = ideal + rng.normal(0, 0.1, ideal.shape)
        face[chosen], plane[chosen] = -1, 3 + i
    return Matches(matches.camera_px, projector_px, face), plane


def _calibrate(matches: Matches, plane: np.ndarray | None) -> SelfCalibration:
    return self_calibrate(
        matches,
        (PAPER_CAMERA.width, PAPER_CAMERA.height),
        (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height),
        principal_point=KNOWN,
        squareness_deg=0.3,
        plane=plane,
    )


def _sigma(found: SelfCalibration) -> float:
    return found.calibration.sigma.camera.focal_px[0] / found.calibration.camera.focal_px[0]


@pytest.mark.parametrize("seed", [3, 8])
def test_further_planes_along_the_faces_lower_the_sigma(seed: int) -> None:
    rng = np.random.default_rng(seed)
    capture = random_capture(rng, walls_off_deg=0.3, distance=(1.5, 2.5))
    matches, plane = _with_planes(capture, (0.2, 0.3, 0.25), 0.0, rng)
    alone, helped = _calibrate(matches, None), _calibrate(matches, plane)
    assert 0.2 < _sigma(helped) / _sigma(alone) < 0.98
    error = np.log(helped.calibration.camera.focal_px[0] / PAPER_CAMERA.focal_px[0])
    assert abs(error) < 4 * _sigma(helped)


def test_planes_that_are_not_square_change_nothing() -> None:
    rng = np.random.default_rng(3)
    capture = random_capture(rng, walls_off_deg=0.3, distance=(1.5, 2.5))
    matches, plane = _with_planes(capture, (0.2, 0.3, 0.25), 12.0, rng)
    alone, together = _calibrate(matches, None), _calibrate(matches, plane)
    assert abs(np.log(_sigma(together) / _sigma(alone))) < 0.05
    assert abs(np.log(together.calibration.camera.focal_px[0] / alone.calibration.camera.focal_px[0])) < 1e-3


def test_wrong_matches_form_no_plane() -> None:
    rng = np.random.default_rng(3)
    capture = random_capture(rng, distance=(1.5, 2.5))
    matches, plane = _with_planes(capture, (0.2,), 0.0, rng)
    wrong = plane == 3
    # As where a thing was pushed after the coarse bits: still smooth, and at the wrong depth by what its fine bits say.
    from_middle = matches.camera_px[wrong] - matches.camera_px[wrong].mean(axis=0)
    matches.projector_px[wrong] += [0.004, -0.008] * from_middle
    alone, together = _calibrate(matches, None), _calibrate(matches, plane)
    assert abs(np.log(_sigma(together) / _sigma(alone))) < 0.05
    off = np.log(together.calibration.camera.focal_px[0] / alone.calibration.camera.focal_px[0])
    assert abs(off) < 0.05 * _sigma(alone)
