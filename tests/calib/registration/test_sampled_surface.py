"""Surfaces are sampled alike wherever they are, and however flat."""

import numpy as np
import pytest

from calib.registration import are_opposed, enclosed_volume, sample_surface
from tests.support.blob import Blob

FAR = np.array([500_000.0, 4_000_000.0, 100.0])


def test_samples_of_a_survey_are_those_near_the_origin() -> None:
    points = np.rint(1024 * Blob().cloud(20_000, 0)[0]) / 1024  # exact, far away as well
    near, far = sample_surface(points, None, 2.0), sample_surface(points + FAR, None, 2.0)
    assert np.abs(far.points - FAR - near.points).max() < 1e-6
    assert np.abs(far.spread - near.spread).max() < 1e-6
    assert np.abs(np.sum(far.normals * near.normals, axis=1)).min() > 0.9999
    assert np.abs(far.on_surface().points - FAR - near.on_surface().points).max() < 1e-3


@pytest.mark.parametrize("off", [0.0, 1e-9])
def test_normals_of_a_plane_are_on_one_side(off: float) -> None:
    rng = np.random.default_rng(1)
    flat = np.column_stack([rng.uniform(-50, 50, (5000, 2)), off * rng.standard_normal(5000)])
    sampled = sample_surface(flat, None, 3.0)
    assert np.abs(sampled.normals[:, 2]).min() > 0.999
    assert abs(np.sign(sampled.normals[:, 2]).sum()) == len(sampled)


def test_a_line_is_no_surface() -> None:
    line = np.linspace(0, 100, 5000)[:, None] * [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match="on a line"):
        sample_surface(line, None, 1.0)


def test_a_mesh_that_is_inside_out_has_a_negative_volume() -> None:
    vertices, triangles = Blob((50.0, 40.0, 30.0), 0.0).mesh(5000)
    true = 4 / 3 * np.pi * 50 * 40 * 30
    for place in (np.zeros(3), np.array([1000.0, -2000.0, 300.0])):
        assert enclosed_volume(vertices + place, triangles) == pytest.approx(true, rel=0.01)
        assert enclosed_volume(vertices + place, triangles[:, ::-1]) == pytest.approx(-true, rel=0.01)


def test_signs_that_mean_nothing_are_seen() -> None:
    points, normals = Blob().cloud(5000, 0)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (len(points), 1))
    assert not are_opposed(points, normals)
    assert not are_opposed(points, -normals)
    assert are_opposed(points, signs * normals)
