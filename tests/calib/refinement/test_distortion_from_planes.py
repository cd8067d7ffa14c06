"""Distortion of both lenses from the straightness of planes alone."""

from dataclasses import replace

import numpy as np
import pytest

from calib.estimation import into_cells
from calib.refinement.distortion_from_planes import _homographies, _misfit, straighten
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture
from tests.support.states import device_of


@pytest.mark.parametrize(("seed", "k1", "k1_projector"), [(1, 0.0, 0.0), (2, -0.1, 0.0), (3, -0.06, 0.05)])
def test_distortion_is_estimated_and_removed(seed: int, k1: float, k1_projector: float) -> None:
    camera = replace(PAPER_CAMERA, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
    projector = replace(PAPER_PROJECTOR, distortion=(k1_projector, 0.0, 0.0, 0.0, 0.0))
    capture = random_capture(np.random.default_rng(seed), camera=camera, projector=projector, count=30_000)
    found = straighten(into_cells(capture.matches), camera.principal_point_px, projector.principal_point_px)
    k1_found = found.camera_bend * camera.focal_px[0] ** 2
    k1_projector_found = found.projector_bend * projector.focal_px[0] ** 2
    assert 1e-6 < abs(k1_found - k1) < 0.01
    assert 1e-6 < abs(k1_projector_found - k1_projector) < 0.01
    bare = replace(capture.calibration, camera=PAPER_CAMERA, projector=PAPER_PROJECTOR)
    rays = bare.camera.unproject(found.matches.camera_px)
    normals = capture.corner.normals[found.matches.face]
    points = (normals @ capture.corner.vertex / np.sum(normals * rays, axis=1))[:, None] * rays
    ideal_px = bare.projector.project(bare.pose @ points)
    assert 1e-4 < np.sqrt(np.mean((ideal_px - found.matches.projector_px) ** 2)) < 1.0


def test_derivatives_match_the_deviations() -> None:
    cells = into_cells(random_capture(np.random.default_rng(4), count=5000).matches)
    camera, projector = device_of(PAPER_CAMERA), device_of(PAPER_PROJECTOR)
    parameters = np.concatenate([_homographies(cells, camera, projector).ravel(), [-0.2, 0.3]])
    _, jacobian = _misfit(cells, camera, projector, parameters)
    for column, step in enumerate(1e-6 * np.eye(len(parameters))):
        ahead, behind = (_misfit(cells, camera, projector, parameters + s)[0] for s in (step, -step))
        found = jacobian[:, :, column]
        np.testing.assert_allclose(found, (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-4 * np.abs(found).max())


def test_unobserved_distortion_stays_at_the_prior() -> None:
    cells = into_cells(
        random_capture(
            np.random.default_rng(4), count=5000, camera=replace(PAPER_CAMERA, distortion=(-0.2, 0, 0, 0, 0))
        ).matches
    )
    shown, hidden = (
        straighten(each, PAPER_CAMERA.principal_point_px, PAPER_PROJECTOR.principal_point_px).camera_bend
        for each in (cells, replace(cells, sigma_px=np.full(len(cells), 1e6)))
    )
    assert abs(hidden) < 0.01 * abs(shown) < 1e-3
