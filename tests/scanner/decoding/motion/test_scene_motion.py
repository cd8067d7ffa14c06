"""The border of a picture in the camera's image, of coordinates that are linear in it."""

import numpy as np
import pytest

from scanner.decoding.motion.registration import TILE_PX
from scanner.decoding.motion.rigid_motion import COLUMNS, PER_DEVICE, shifts_of_picture
from scanner.decoding.motion.scene_motion import BORDER, LitScene

SIZE = (120, 90)


@pytest.mark.parametrize("moved", [(0.0, 0.0), (3.0, -2.0)])
@pytest.mark.parametrize(("across", "down"), [((1.1, 0.2), (-0.3, 0.9)), ((0.5, -0.4), (0.3, 0.6))])
def test_the_border_is_where_coordinates_or_their_planes_reach_it(
    across: tuple[float, float], down: tuple[float, float], moved: tuple[float, float]
) -> None:
    """Beside the picture nothing is known: there the planes of the tiles tell."""
    rows, columns = 14 * TILE_PX, 18 * TILE_PX
    y, x = np.mgrid[:rows, :columns] - np.array([rows, columns]).reshape(2, 1, 1) / 2
    truth = np.stack([across[0] * x + across[1] * y, down[0] * x + down[1] * y], axis=-1) + np.array(SIZE) / 2
    inside = np.minimum(truth, np.array(SIZE) - 1.0 - truth).min(axis=-1) > 0
    seen = np.where(inside[..., None], truth, np.nan).astype(np.float32)
    scene = LitScene(seen, 0.0, np.ones(2), SIZE, (columns, rows), (0, 0), 1)
    # A projector's picture that moves to the right takes its coordinates along.
    motion, reach_px = np.append(-np.array(moved), np.zeros(COLUMNS - 2)), 4.0

    near = scene.labels(motion, reach_px) == BORDER

    steep = np.hypot([across[0], down[0]], [across[1], down[1]])
    at = truth + (shifts_of_picture(truth.reshape(-1, 2), SIZE) @ motion[:PER_DEVICE]).reshape(truth.shape)
    off_px = np.abs(np.min(np.minimum(at, np.array(SIZE) - 1.0 - at) / steep, axis=-1))
    has_plane = np.kron(scene.planes.known.reshape(rows // TILE_PX, -1), np.ones((TILE_PX, TILE_PX))).astype(bool)
    sure = has_plane & (np.abs(off_px - reach_px) > 0.2)
    assert np.count_nonzero(near & ~inside) > 100
    assert np.count_nonzero(sure & ~inside) > 100
    np.testing.assert_array_equal(near[sure], off_px[sure] < reach_px)
