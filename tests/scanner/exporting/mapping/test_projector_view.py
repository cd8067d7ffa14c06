"""What a projector lights of one triangle whose normals turn away from the wall that shows the picture."""

from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Intrinsics, Pose
from calib.numerics import Floats
from scanner.exporting import Mesh
from scanner.exporting.mapping.projector_view import view_surface
from scanner.exporting.mapping.scene import MappedWall, WallView
from scanner.io import StoredDevice, scratch_rows

WIDTH, HEIGHT, METRES = 60, 40, 0.5
CORNERS = np.array([[-1.5, -1.0, 2.0], [1.5, -1.0, 2.4], [0.0, 1.5, 1.8]])
GRAZING_DEG = 10.0


def test_a_surface_is_lit_where_its_interpolated_normal_is_not_grazing(tmp_path: Path) -> None:
    """From one corner, whose normal is the wall's, to the two others, of which one is at a right angle to it."""
    tilts = np.radians([0.0, 90.0, 60.0])
    normals = np.stack([np.sin(tilts), np.zeros(3), -np.cos(tilts)], axis=1)
    mesh = Mesh(CORNERS, normals, np.zeros((3, 3), np.uint8), np.array([[0, 1, 2]]), "m")
    lens = Intrinsics(WIDTH, HEIGHT, (50.0, 50.0), (29.5, 19.5), (-0.1, 0.0, 0.0, 0.0, 0.0))
    place = Pose(np.eye(3), np.array([0.1, 0.05, -0.2]))
    device = StoredDevice("stage", "projector", lens, place)
    viewpoint = WallView(MappedWall(np.array([0.0, 0.0, -1.0]), -3.0, 0.01), None)
    to_file = METRES * np.array([1.0, -1.0, -1.0])
    shape = HEIGHT, WIDTH
    with (
        scratch_rows(tmp_path, shape) as depth,
        scratch_rows(tmp_path, (*shape, 3)) as position,
        scratch_rows(tmp_path, (*shape, 2)) as on_wall,
    ):
        view = view_surface(device, mesh, viewpoint, to_file, depth, position, on_wall)
        points, is_shown = position.read_all() / to_file, np.isfinite(on_wall.read_all()[..., 0])
        is_lit = depth.read_all() > 0
    assert 0.3 < is_lit.mean() < 0.9
    # Shares of the corners, by solving for them; all points are on the triangle.
    shares = points[is_lit] @ np.linalg.inv(CORNERS)
    assert np.abs(shares.sum(axis=1) - 1).max() < 1e-5
    assert shares.min() > -1e-5
    facing: Floats = shares @ np.cos(tilts)
    sine = float(np.sin(np.radians(GRAZING_DEG)))
    clear, is_facing = np.flatnonzero(np.abs(facing - sine) > 1e-4), np.asarray(facing > sine)
    assert np.array_equal(is_shown[is_lit][clear], is_facing[clear])
    assert 0.7 < is_facing.mean() < 0.98
    assert not is_shown[~is_lit].any()
    along = (points[is_lit] - place.translation)[:, 2]
    assert view.nearest == pytest.approx(METRES * along.min(), rel=1e-5)
    assert view.farthest == pytest.approx(METRES * along.max(), rel=1e-5)
    assert np.isinf(view.part.low).all()  # nothing is on the wall itself
