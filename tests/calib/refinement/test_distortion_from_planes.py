"""The bend of both lenses from the straightness of planes alone."""

from dataclasses import replace

import numpy as np
import pytest

from calib.refinement.distortion_from_planes import straighten
from calib.refinement.match_cells import into_cells
from calib.synthetic.captures import PAPER_CAMERA, PAPER_PROJECTOR, random_capture


@pytest.mark.parametrize(("seed", "k1", "k1_projector"), [(1, 0.0, 0.0), (2, -0.1, 0.0), (3, -0.06, 0.05)])
def test_bends_are_found_and_taken_off(seed: int, k1: float, k1_projector: float) -> None:
    camera = replace(PAPER_CAMERA, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
    projector = replace(PAPER_PROJECTOR, distortion=(k1_projector, 0.0, 0.0, 0.0, 0.0))
    capture = random_capture(np.random.default_rng(seed), camera=camera, projector=projector, count=30_000)
    found = straighten(into_cells(capture.matches), camera.principal_point_px, projector.principal_point_px)
    k1_found = found.camera_bend * camera.focal_px[0] ** 2
    k1_projector_found = found.projector_bend * projector.focal_px[0] ** 2
    assert 0 < abs(k1_found - k1) < 0.01
    assert 0 < abs(k1_projector_found - k1_projector) < 0.01
    bare = replace(capture.calibration, camera=PAPER_CAMERA, projector=PAPER_PROJECTOR)
    rays = bare.camera.unproject(found.matches.camera_px)
    normals = capture.corner.normals[found.matches.face]
    points = (normals @ capture.corner.vertex / np.sum(normals * rays, axis=1))[:, None] * rays
    ideal_px = bare.projector.project(points @ bare.rotation.T + bare.translation)
    assert 0 < np.sqrt(np.mean((ideal_px - found.matches.projector_px) ** 2)) < 1.0
