"""Photos of random corners: accuracy, true sigmas, and refusals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.geometry import Intrinsics, Matches
from calib.plane_segmentation import find_sparse_faces
from calib.refinement import CAMERA, PROJECTOR, PlacedCorner, PrincipalPoint, State, predict, without_lens
from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration
from calib.self_calibration.photos import anywhere, calibrate_photos
from calib.synthetic import SyntheticPhotos, random_photos

SIZE = (1600, 1200)
WIDTH = SIZE[0]


def solve(photos: SyntheticPhotos, **options: Any) -> SelfCalibration:
    camera = photos.camera
    return calibrate_photos(
        [matches for matches, _ in photos.pairs], (camera.width, camera.height), **({"squareness_deg": 0.0} | options)
    )[0]


def errors_and_sigmas(photos: SyntheticPhotos, found: SelfCalibration) -> tuple[np.ndarray, np.ndarray]:
    """Errors and sigmas of (f, x_0, y_0), (3,): f relative to itself, the others to the width."""
    camera, truth, sigma = found.calibration.camera, photos.camera, found.calibration.sigma
    scale = np.array([truth.focal_px[0], truth.width, truth.width])
    error = [camera.focal_px[0] - truth.focal_px[0], *np.subtract(camera.principal_point_px, truth.principal_point_px)]
    return np.array(error) / scale, np.array([sigma.camera.focal_px[0], *sigma.camera.principal_point_px]) / scale


def test_random_corners_are_accurate_and_their_sigmas_are_true() -> None:
    outcomes = []
    for number in range(2):
        photos = random_photos(np.random.default_rng([1, number]), distortion=-0.03 * (number % 2))
        found = solve(photos)
        assert found.calibration.one_camera
        assert 0.35 < found.residual_px < 0.8
        outcomes.append(errors_and_sigmas(photos, found))
    errors, sigmas = (np.array(each) for each in zip(*outcomes, strict=True))
    assert 1e-5 < np.abs(errors[:, 0]).mean() < 0.004
    assert 1e-5 < np.abs(errors[:, 1:]).mean() < 0.0025
    assert 0.5 < np.sqrt(np.mean((errors / sigmas) ** 2)) < 1.6


def test_further_photos_measure_the_walls_angles() -> None:
    photos = random_photos(np.random.default_rng([2, 0]), photos=3, walls_off_deg=0.3)
    error, sigma = errors_and_sigmas(photos, solve(photos, squareness_deg=0.3))
    pair = replace(photos, pairs=photos.pairs[:1])
    _, sigma_of_two = errors_and_sigmas(pair, solve(pair, squareness_deg=0.3))
    assert np.all(sigma < sigma_of_two)
    assert np.all(np.abs(error) < 5 * sigma)
    assert 1e-6 < abs(error[0]) < 0.004


def test_every_pair_has_its_own_motion() -> None:
    photos = random_photos(np.random.default_rng([2, 1]), photos=3)
    found = calibrate_photos([matches for matches, _ in photos.pairs], SIZE, squareness_deg=0.0)
    assert len(found) == 2
    assert found[0].calibration.camera == found[1].calibration.camera
    for solution, (_, truth) in zip(found, photos.pairs, strict=True):
        assert np.linalg.norm(solution.calibration.pose.translation) == pytest.approx(1.0)
        assert np.degrees(np.arccos(solution.calibration.pose.translation @ truth.pose.translation)) < 1.0
        assert np.abs(solution.calibration.pose.rotation - truth.pose.rotation).max() < 0.005


def test_a_crop_changes_nothing_but_the_principal_point() -> None:
    photos = random_photos(np.random.default_rng([3, 0]), shift=0.0)
    low = np.array([0.0, 90.0])
    size = (1440, 1100)
    centre = np.array(photos.camera.principal_point_px) - low
    smaller = Intrinsics(*size, photos.camera.focal_px, (float(centre[0]), float(centre[1])))
    matches, truth = photos.pairs[0]
    a, b = matches.camera_px - low, matches.projector_px - low
    inside = np.all((a >= 0) & (b >= 0) & (a < size) & (b < size), axis=1)
    window = replace(
        photos,
        pairs=((Matches(a, b, matches.face)[inside], replace(truth, camera=smaller, projector=smaller)),),
    )
    whole, cropped = (errors_and_sigmas(each, solve(each)) for each in (photos, window))
    for error, sigma in (whole, cropped):
        assert np.all(np.abs(error) < 4 * sigma)
    assert 0.5 < cropped[1][0] / whole[1][0] < 2.5


def test_a_known_principal_point_and_a_known_focal_length_are_used() -> None:
    photos = random_photos(np.random.default_rng([4, 0]), walls_off_deg=0.3)
    free = solve(photos, squareness_deg=0.3).calibration
    known = PrincipalPoint(photos.camera.principal_point_px, 0.0)
    held = solve(photos, squareness_deg=0.3, principal_point=known).calibration
    focal = photos.camera.focal_px[0]
    guided = solve(photos, squareness_deg=0.3, focal_px=(focal, 1e-4 * focal)).calibration
    assert held.camera.principal_point_px == known.px
    assert held.sigma.camera.principal_point_px == (0.0, 0.0)
    assert 0.5e-4 * focal < guided.sigma.camera.focal_px[0] <= 1.1e-4 * focal < free.sigma.camera.focal_px[0]


def test_derivatives_of_the_shared_camera_are_exact() -> None:
    photos = random_photos(np.random.default_rng(5), photos=3, count=300)
    matches, truth = photos.pairs[1]
    camera = np.array([truth.camera.focal_px[0], *truth.camera.principal_point_px, -0.05, 0.01, 1e-3, -5e-4, 0.01])
    first = photos.pairs[0][1]
    state = State(
        camera,
        camera,
        first.pose,
        np.radians([[0.4, -0.2, 0.7]]),
        (PlacedCorner(photos.corner.legs, photos.corner.vertex),),
        one_camera=True,
        further=(truth.pose.scaled(1.3),),
    )
    for capture in (0, 1):
        _, jacobian, _ = predict(state, matches.camera_px, matches.face, capture)
        columns = state.columns(capture)
        for column in range(state.size):
            step = np.zeros(state.size)
            step[column] = 1e-6
            ahead, behind = (
                predict(state.moved(sign * step), matches.camera_px, matches.face, capture)[0] for sign in (1, -1)
            )
            exact = np.zeros((len(matches), 2)) + jacobian[:, :, columns == column].sum(axis=2)
            numerical = (ahead - behind) / 2e-6
            assert np.abs(numerical - exact).max() < 1e-5 * max(1.0, np.abs(exact).max()), f"column {column}"


def test_step_to_is_the_inverse_of_moved() -> None:
    photos = random_photos(np.random.default_rng(6), photos=3, count=100)
    camera = without_lens(1500.0, np.array([700.0, 600.0]), -0.05)
    (_, first), (_, second) = photos.pairs
    state = State(
        camera,
        camera,
        first.pose,
        np.zeros((1, 3)),
        (PlacedCorner(photos.corner.legs, photos.corner.vertex),),
        one_camera=True,
        further=(second.pose.scaled(0.8),),
    )
    step = np.random.default_rng(0).normal(0, 1e-4, state.size)
    step[PROJECTOR] = step[CAMERA]  # the projector is the camera
    moved = state.moved(step)
    assert np.array_equal(moved.camera, moved.projector)
    assert np.allclose(state.step_to(moved), step, atol=1e-7)


def test_faces_are_found_among_sparse_matches_with_outliers() -> None:
    rng = np.random.default_rng(7)
    (matches, _) = random_photos(rng, distortion=-0.05).pairs[0]
    wrong = rng.random(len(matches)) < 0.1
    second = np.where(wrong[:, None], rng.uniform((0, 0), SIZE, matches.projector_px.shape), matches.projector_px)
    found = find_sparse_faces(Matches(matches.camera_px, second), SIZE).matches.face
    assert np.mean(found[wrong] >= 0) < 0.03
    counts = np.zeros((3, 3), int)
    labelled = ~wrong & (found >= 0)
    np.add.at(counts, (matches.face[labelled], found[labelled]), 1)
    assert 0.93 < labelled.sum() / (~wrong).sum() <= 1
    assert 0.98 < counts.max(axis=0).sum() / counts.sum() <= 1
    assert len(set(counts.argmax(axis=0))) == 3


def flat_wall(rng: np.random.Generator) -> Matches:
    pixels = rng.uniform((0, 0), SIZE, (900, 2))
    homography = np.array([[1.0, 0.05, 20.0], [-0.03, 0.95, -10.0], [2e-5, 1e-5, 1.0]])
    mapped = np.concatenate([pixels, np.ones((900, 1))], axis=1) @ homography.T
    second = mapped[:, :2] / mapped[:, 2:] + rng.normal(0, 0.3, pixels.shape)
    return Matches(pixels, second, (np.arange(900) % 3).astype(np.int32))


def test_a_flat_wall_is_refused_with_and_without_faces() -> None:
    matches = flat_wall(np.random.default_rng(8))
    with pytest.raises(RefusalError, match="one plane"):
        calibrate_photos([matches], SIZE)
    with pytest.raises(RefusalError, match="Only one plane"):
        find_sparse_faces(replace(matches, face=None), SIZE)


def test_too_few_matches_are_refused() -> None:
    (matches, _) = random_photos(np.random.default_rng(9), count=300).pairs[0]
    with pytest.raises(RefusalError, match="too few"):
        find_sparse_faces(replace(matches, face=None)[:40], SIZE)
    face = matches.face.copy()
    face[np.flatnonzero(face == 2)[3:]] = -1
    with pytest.raises(RefusalError, match="too few matches"):
        calibrate_photos([matches.with_faces(face)], SIZE)


def test_walls_far_from_square_are_refused() -> None:
    photos = random_photos(np.random.default_rng(10), walls_off_deg=8.0, photos=3)
    with pytest.raises(RefusalError, match=r"square|corner|widths"):
        solve(photos, squareness_deg=0.0)


def test_a_principal_point_may_be_anywhere_in_the_photo() -> None:
    point = anywhere(SIZE)
    assert point.px == (799.5, 599.5)
    assert 0.15 * WIDTH < point.sigma_px < WIDTH
