"""Normal matrices of homographies, accumulated in one pass over all matches."""

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry.homography import (
    TooFewMatchesError,
    dehomogenise,
    face_grams,
    homogeneous,
    homography_between,
    homography_from_gram,
    mapped,
)
from calib.synthetic import random_capture


def _equations(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The rows of the direct linear transform, (2 N, 9)."""
    x = homogeneous(source)
    zero = np.zeros_like(x)
    first = np.concatenate([x, zero, -target[:, :1] * x], axis=1)
    return np.concatenate([first, np.concatenate([zero, x, -target[:, 1:] * x], axis=1)])


def test_gram_matrices_match_the_stacked_equations() -> None:
    matches = random_capture(np.random.default_rng(1), count=3000).matches
    grams = face_grams(matches)
    for label in range(3):
        on_face = matches.on_face(label)
        camera, projector = (
            dehomogenise(homogeneous(pixels) @ scale.T)
            for pixels, scale in (
                (on_face.camera_px, grams.camera_scale),
                (on_face.projector_px, grams.projector_scale),
            )
        )
        there, back = _equations(camera, projector), _equations(projector, camera)
        np.testing.assert_allclose(grams.to_projector[label], there.T @ there / len(on_face), atol=1e-12)
        np.testing.assert_allclose(grams.to_camera[label], back.T @ back / len(on_face), atol=1e-12)


def test_a_homography_is_found_and_applied() -> None:
    rng = np.random.default_rng(2)
    homography = np.array([[900.0, 30.0, 700.0], [-20.0, 850.0, 400.0], [0.1, -0.05, 1.0]]) @ np.diag([1e-3, 1e-3, 1])
    source = rng.uniform(0, 2000, (200, 2))
    target = dehomogenise(homogeneous(source) @ homography.T)
    np.testing.assert_allclose(mapped(homography, source), target, rtol=1e-12)
    found = homography_between(source, target)
    np.testing.assert_allclose(found / found[2, 2], homography, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("number", [np.float32, np.float64])
def test_gram_matrices_give_the_homographies_for_any_order_of_matches(number: type) -> None:
    capture = random_capture(np.random.default_rng(2), count=5000, noise_px=0.0)
    matches = capture.matches
    order = np.random.default_rng(3).permutation(len(matches))
    face = matches.face.copy()
    face[::7] = -1  # not on any face: without influence
    stored = replace(
        matches,
        camera_px=matches.camera_px[order].astype(number),
        projector_px=matches.projector_px[order].astype(number),
        face=face[order],
    )
    grams = face_grams(stored)
    tolerance_px = 1e-6 if number is np.float64 else 1e-3
    for label, homography in enumerate(grams.homographies()):
        on_face = matches.on_face(label)
        mapped = dehomogenise(homogeneous(on_face.camera_px) @ homography.T)
        assert np.abs(mapped - on_face.projector_px).max() < tolerance_px
    back = grams.reversed()
    there, again = (homography_from_gram(each[0]) for each in (grams.to_projector, back.to_projector))
    product = there @ again
    np.testing.assert_allclose(product / product[2, 2], np.eye(3), atol=1e-3)


def test_too_few_matches_are_named() -> None:
    matches = random_capture(np.random.default_rng(2), count=2000).matches
    face = matches.face.copy()
    face[np.flatnonzero(face == 1)[3:]] = -1
    with pytest.raises(TooFewMatchesError, match="face 1 has 3 matches"):
        face_grams(matches.with_faces(face))
