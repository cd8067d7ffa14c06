"""What the covariance predicts for points, for an assumption, and for a further capture."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.diagnostics.next_best_view import best_next_view, moved_corner
from calib.diagnostics.uncertainty import Uncertainty
from calib.estimation import into_cells
from calib.geometry import Matches, unproject
from calib.refinement import CAMERA, SHARED, Knowledge, depths, family_of, refine, straighten
from calib.self_calibration import PrincipalPoint, self_calibrate, self_calibrate_jointly
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

CAMERA_SIZE = (PAPER_CAMERA.width, PAPER_CAMERA.height)
PROJECTOR_SIZE = (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)
KNOWLEDGE = Knowledge(CAMERA_SIZE, PROJECTOR_SIZE, KNOWN.px, 0.0, 0.3)


@pytest.fixture(scope="module")
def uncertainty_and_matches() -> tuple[Uncertainty, Matches]:
    capture = random_capture(np.random.default_rng(2), count=6000, distance=(1.5, 2.5))
    found = self_calibrate(capture.matches, CAMERA_SIZE, PROJECTOR_SIZE, principal_point=KNOWN, squareness_deg=0.0)
    assert found.uncertainty is not None
    return found.uncertainty, found.matches[:500]


@pytest.mark.parametrize("column", range(SHARED))
def test_points_move_with_every_parameter_as_predicted(
    uncertainty_and_matches: tuple[Uncertainty, Matches], column: int
) -> None:
    uncertainty, matches = uncertainty_and_matches
    # Matches that the calibration explains exactly, so that rays meet.
    state = uncertainty.state
    direction = np.zeros(SHARED)
    direction[column] = 1e-6
    alone = replace(uncertainty, covariance=np.outer(direction, direction), match_px=0.0)
    points = []
    for sign in (1, -1):
        step = np.zeros(state.size)
        step[:SHARED] = sign * direction
        moved = state.moved(step)
        rays, _ = unproject(moved.camera, matches.camera_px)
        points.append(rays * depths(moved, rays, matches.projector_px)[:, None])
    numerical = np.abs(points[0] - points[1]) / 2
    stated = alone.of_points(matches)
    scale = stated.max()
    assert scale > 0
    assert np.abs(stated - numerical).max() < 0.03 * scale


def test_noise_of_the_matches_moves_points_as_predicted(uncertainty_and_matches: tuple[Uncertainty, Matches]) -> None:
    uncertainty, matches = uncertainty_and_matches
    sigma_px = 0.05
    stated = replace(uncertainty, covariance=np.zeros((SHARED, SHARED)), match_px=sigma_px).of_points(matches)
    rays, _ = unproject(uncertainty.state.camera, matches.camera_px)
    rng = np.random.default_rng(0)
    depth = np.stack(
        [
            depths(uncertainty.state, rays, matches.projector_px + rng.normal(0, sigma_px, (len(rays), 2)))
            for _ in range(300)
        ]
    )
    ratio = np.median(stated[:, 2] / depth.std(axis=0))
    assert 0.9 < ratio < 1.1


def test_the_cost_of_a_wrong_principal_point_is_predicted(uncertainty_and_matches: tuple[Uncertainty, Matches]) -> None:
    capture = random_capture(np.random.default_rng(2), count=6000, distance=(1.5, 2.5))
    uncertainty, _ = uncertainty_and_matches
    assert uncertainty.by_principal_point is not None
    shifted = PrincipalPoint((KNOWN.px[0] + 2.0, KNOWN.px[1]), 0.0)
    found = self_calibrate(capture.matches, CAMERA_SIZE, PROJECTOR_SIZE, principal_point=shifted, squareness_deg=0.0)
    told = 2.0 * uncertainty.by_principal_point[CAMERA.start, 0]
    paid = np.log(found.calibration.camera.focal_px[0] / uncertainty.state.camera[0])
    assert 1e-4 < abs(told) < 0.1
    assert 0.5 < paid / told < 1.5


def test_the_next_view_reduces_sigmas_as_predicted() -> None:
    rng = np.random.default_rng(4)
    capture = random_capture(rng, count=20_000, walls_off_deg=0.3, distance=(1.5, 2.5))
    cells = into_cells(capture.matches)
    trials = np.geomspace(800.0, 8000.0, 28)
    refinement = refine([cells], [family_of(cells, KNOWLEDGE)], trials, KNOWLEDGE, same=True)
    assert refinement is not None
    view = best_next_view(refinement, KNOWLEDGE)
    assert view is not None
    now = np.sqrt(refinement.covariance[0, 0])
    assert 0 < view.sigma < 0.5 * now

    # The rig goes there: every ray of a grid meets a wall of the true corner.
    truth, baseline = capture.calibration, capture.calibration.baseline
    corner = moved_corner(
        replace(refinement.fit.state.corners[0], frame=capture.corner.legs, vertex=capture.corner.vertex / baseline),
        view.right_deg,
        view.up_deg,
        view.distance,
    )
    x, y = np.meshgrid(np.arange(0, CAMERA_SIZE[0], 12.0), np.arange(0, CAMERA_SIZE[1], 12.0))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    rays = truth.camera.unproject(pixels)
    normals = np.cross(np.roll(corner.frame, -1, axis=0), np.roll(corner.frame, -2, axis=0))
    depth = (normals @ corner.vertex) / (rays @ normals.T)
    depth[depth <= 0] = np.inf
    face = np.argmin(depth, axis=1).astype(np.int32)
    points = baseline * rays * depth[np.arange(len(face)), face][:, None]
    projector_px = truth.projector.project(truth.pose @ points)
    with np.errstate(invalid="ignore"):
        lit = np.all((projector_px >= 0) & (projector_px <= (853, 479)), axis=1)
    projector_px = projector_px[lit] + rng.normal(0, 0.1, (int(lit.sum()), 2))
    second = Matches(pixels[lit], projector_px, face[lit])
    joint = self_calibrate_jointly(
        [capture.matches, second], CAMERA_SIZE, PROJECTOR_SIZE, principal_point=KNOWN, squareness_deg=0.3
    )
    calibration = joint[0].calibration
    reached = calibration.sigma.camera.focal_px[0] / calibration.camera.focal_px[0]
    # Told from a solution that errs by per cents, so in order of magnitude; rather too little than too much.
    assert 0.03 < reached / view.sigma < 3


@pytest.mark.parametrize("bends", [(-0.06, -0.03), (0.05, 0.0), (0.0, 0.02)])
def test_straightness_of_planes_gives_the_lens_distortion(bends: tuple[float, float]) -> None:
    camera = replace(PAPER_CAMERA, distortion=(bends[0], 0.0, 0.0, 0.0, 0.0))
    projector = replace(PAPER_PROJECTOR, distortion=(bends[1], 0.0, 0.0, 0.0, 0.0))
    capture = random_capture(np.random.default_rng(1), camera=camera, projector=projector, noise_px=0.01)
    found = straighten(into_cells(capture.matches), KNOWN.px, PAPER_PROJECTOR.principal_point_px)
    # A bend on one side can stand for one on the other; what counts is that planes become straight.
    cells = into_cells(capture.matches)
    bent = _bend_of_faces(Matches(cells.camera_px, cells.projector_px, cells.plane))
    assert 0 < _bend_of_faces(found.matches) < 0.2 * bent


def _bend_of_faces(matches: Matches) -> float:
    """Root mean square deviation from the faces' homographies, in px."""
    squares = []
    for face in range(3):
        on_face = matches.on_face(face)
        homography, _ = cv2.findHomography(on_face.camera_px, on_face.projector_px)
        mapped = cv2.perspectiveTransform(on_face.camera_px[None], homography)[0]
        squares.append(np.sum((mapped - on_face.projector_px) ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))
