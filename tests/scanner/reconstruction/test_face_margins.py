"""Faces lose the margin where a blurred lens mixes them."""

import numpy as np

from calib.geometry import NO_FACE, Matches
from scanner.reconstruction.calibrate import without_margins

SIZE = (80, 60)


def halves() -> Matches:
    """Two faces side by side that meet at column 40; one of them has a pixel without a match."""
    row, column = np.divmod(np.arange(SIZE[0] * SIZE[1]), SIZE[0])
    there = ~((row == 30) & (column == 20))
    pixels = np.stack([column, row], axis=1)[there].astype(np.float64)
    return Matches(pixels, pixels).with_faces((pixels[:, 0] >= 40).astype(np.int32))


def test_with_a_sharp_lens_faces_keep_their_margins() -> None:
    matches = halves()
    assert without_margins(matches, SIZE, 0.0) is matches
    assert without_margins(matches, SIZE, 0.9) is matches


def test_matches_within_two_blur_sigmas_of_the_border_lose_their_face() -> None:
    found = without_margins(halves(), SIZE, 4.0)
    assert found.face is not None
    column, row = found.camera_px.T
    near = np.abs(column - 39.5) < 4
    assert np.all(found.face[near] == NO_FACE)
    inner = (np.abs(column - 39.5) > 5) & (np.minimum(column, 79 - column) > 5) & (np.minimum(row, 59 - row) > 5)
    np.testing.assert_array_equal(found.face[inner], column[inner] >= 40)
