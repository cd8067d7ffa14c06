"""Means over cells lie on the plane, are robust to outliers, and do not depend on the order."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.estimation.match_cells import Cells, follow_one_plane, into_cells
from calib.geometry import Matches, TooFewMatchesError
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

LENSES: dict[str, Any] = {
    "camera": replace(PAPER_CAMERA, distortion=(-0.06, 0.0, 0.0, 0.0, 0.0)),
    "projector": replace(PAPER_PROJECTOR, distortion=(-0.03, 0.0, 0.0, 0.0, 0.0)),
}


def _matches(noise_px: float, **options: Any) -> tuple[Matches, Matches]:
    """Noisy matches, and their pixels without noise."""
    noisy, exact = (
        random_capture(np.random.default_rng(4), count=30_000, noise_px=noise, **LENSES, **options).matches
        for noise in (noise_px, 0.0)
    )
    return noisy, exact


def _apart(cells: Cells, exact: Matches) -> np.ndarray:
    """Distance of each cell's mean from the nearest exact match, moved there along the plane, (M, 2)."""
    apart = []
    for camera_px, projector_px, plane in zip(cells.camera_px, cells.projector_px, cells.plane, strict=True):
        on_plane = exact.on_face(int(plane))
        near = np.argsort(np.sum((on_plane.camera_px - camera_px) ** 2, axis=1))[:12]
        steps = np.column_stack([np.ones(len(near)), on_plane.camera_px[near] - camera_px])
        apart.append(projector_px - np.linalg.lstsq(steps, on_plane.projector_px[near], rcond=None)[0][0])
    return np.array(apart)


def test_means_lie_on_the_bent_planes() -> None:
    _, exact = _matches(0.0)
    cells = into_cells(exact)
    assert 300 < len(cells) < 1500
    assert 1e-4 < np.abs(_apart(cells, exact)).max() < 0.02


def test_standard_errors_are_true_and_outliers_are_left_out() -> None:
    clean, exact = _matches(0.1)
    rng = np.random.default_rng(5)
    wrong = np.flatnonzero(rng.random(len(clean)) < 0.03)
    projector_px = clean.projector_px.copy()
    projector_px[wrong] += rng.normal(0, 50, (len(wrong), 2))
    cells = into_cells(replace(clean, projector_px=projector_px))
    assert 0.02 < cells.rejected < 0.05  # with what is in cells that are nearly empty
    assert 0.095 < cells.noise_px < 0.105
    assert 0.85 < np.sqrt(np.mean((_apart(cells, exact) / cells.sigma_px[:, None]) ** 2)) < 1.15


@pytest.mark.parametrize("number", [np.float32, np.float64])
def test_the_order_of_the_matches_does_not_matter(number: type) -> None:
    matches, _ = _matches(0.1)
    matches = replace(
        matches, camera_px=matches.camera_px.astype(number), sigma_px=np.where(matches.face == 1, 0.2, 0.1)
    )
    order = np.random.default_rng(6).permutation(len(matches))
    labels = np.array([5, -1, 2, 9], np.int32)[matches.face]  # face 1 has no label: −1 is none
    cells = into_cells(matches, (2, 5), labels)
    mixed = into_cells(matches[order], (2, 5), labels[order])
    assert set(cells.plane) == {2, 5}
    np.testing.assert_allclose(mixed.camera_px, cells.camera_px, atol=1e-6)
    np.testing.assert_allclose(mixed.projector_px, cells.projector_px, atol=2e-3)
    np.testing.assert_allclose(mixed.sigma_px, cells.sigma_px, rtol=2e-2)


def test_too_few_matches_are_named() -> None:
    matches, _ = _matches(0.1)
    face = np.where(np.arange(len(matches)) < 3, 0, -1).astype(np.int32)
    with pytest.raises(TooFewMatchesError, match="face 0 has 3 matches"):
        into_cells(matches.with_faces(face), (0,))


def test_the_matches_of_a_bent_plane_are_told_from_those_of_another() -> None:
    matches, _ = _matches(0.1)
    other = np.flatnonzero(matches.face == 1)[::4]
    both = matches[np.sort(np.concatenate([np.flatnonzero(matches.face == 0), other]))]
    on = follow_one_plane(both, 0.5)
    assert 0.99 < on[both.face == 0].mean() <= 1.0
    assert 0.0 <= on[both.face == 1].mean() < 0.1
    # A larger tolerance takes in more of the other plane.
    assert on[both.face == 1].mean() < follow_one_plane(both, 20.0)[both.face == 1].mean() < 1.0


def test_a_plane_needs_four_matches() -> None:
    matches, _ = _matches(0.1)
    on_one = matches.on_face(0)[::1000]
    assert follow_one_plane(on_one[:4], 0.5).shape == (4,)
    with pytest.raises(TooFewMatchesError, match="a plane has 3 matches"):
        follow_one_plane(on_one[:3], 0.5)


def test_nearly_empty_cells_are_left_out() -> None:
    noisy, _ = _matches(0.1)
    cells = into_cells(noisy)
    per_cell = (cells.noise_px / cells.sigma_px) ** 2
    for plane in range(3):
        of_plane = per_cell[cells.plane == plane]
        # Fewer than a fifth of what a typical match has around it: strays, or the edge of a face that cuts a cell off.
        typical = np.sort(of_plane)[np.searchsorted(np.cumsum(np.sort(of_plane)), of_plane.sum() / 2)]
        assert 0.18 < of_plane.min() / typical < 0.5


def test_an_image_whose_rows_are_as_long_as_the_samples_are_apart() -> None:
    """Every fortieth match of this strip is in its first column."""
    camera_px = np.stack(np.meshgrid(np.arange(40.0), np.arange(10_000.0)), axis=-1).reshape(-1, 2)

    def bent(pixels: np.ndarray) -> np.ndarray:
        return pixels + 1e-7 * pixels[:, 1:] ** 2

    cells = into_cells(Matches(camera_px, bent(camera_px), np.zeros(len(camera_px), np.int32)), (0,))
    assert 30 < cells.camera_px[:, 0].max() < 39
    assert 1e-13 < np.abs(cells.projector_px - bent(cells.camera_px)).max() < 1e-6
