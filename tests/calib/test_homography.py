"""Normal matrices of homographies, accumulated in one pass over all matches."""

from dataclasses import replace

import numpy as np
import pytest

from calib.homography import TooFewMatchesError, dehomogenise, dlt_gram, face_grams, homogeneous, homography_from_gram
from calib.synthetic import random_capture


def test_the_gram_matrix_is_that_of_the_stacked_equations() -> None:
    rng = np.random.default_rng(1)
    source, target = rng.normal(size=(2, 50, 2))
    x = homogeneous(source)
    zero = np.zeros_like(x)
    first = np.concatenate([x, zero, -target[:, :1] * x], axis=1)
    second = np.concatenate([zero, x, -target[:, 1:] * x], axis=1)
    expected = (first.T @ first + second.T @ second) / len(source)
    np.testing.assert_allclose(dlt_gram(source, target), expected, atol=1e-12)


@pytest.mark.parametrize("number", [np.float32, np.float64])
def test_grams_of_faces_give_the_homographies_whatever_the_order(number: type) -> None:
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
