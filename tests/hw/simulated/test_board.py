"""A board in front of the simulated rig."""

import cv2
import numpy as np
import pytest

from hw.errors import DeviceError
from hw.settings import BoardSettings, SimulatedRigSettings
from hw.simulated.board import draw_board
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.simulation import SimulatedRoom

pytestmark = pytest.mark.xdist_group("simulated_board")

SIZES = (306, 256), (214, 120)


@pytest.fixture(scope="module")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0, interreflection=False, furniture=False, ambient=0), *SIZES)


def test_the_board_appears_at_its_true_corners(room: SimulatedRoom) -> None:
    posed = room.under(board={"square_m": 0.08, "columns": 5, "rows": 4})
    board = posed.renderer.caster.board
    projector = SimulatedProjector(posed)
    projector.show(np.full(SIZES[1][::-1], 255, np.uint8))
    frame = SimulatedCamera(posed, projector).grab().image
    expected = posed.room.camera.project(board.points(board.corners.T))[0].T
    found = cv2.cornerSubPix(frame, np.ascontiguousarray(expected, np.float32), (3, 3), (-1, -1), (3, 50, 1e-3))
    off = np.linalg.norm(found - expected, axis=1)
    assert 0.001 < np.median(off) < 0.12
    changed = posed.renderer.footprints.direct - room.renderer.footprints.direct
    assert np.count_nonzero(changed.data) > 1000


def test_a_board_hides_the_room_and_the_board_before_it(room: SimulatedRoom) -> None:
    """Its inside is the same whatever is behind it, and beside it the room is as it was."""
    small, large = ({"square_m": side, "columns": 5, "rows": 4} for side in (0.05, 0.08))
    white = np.full(SIZES[1][::-1], 255, np.uint8)
    bare, first, second = (
        each.renderer.render(white) for each in (room, room.under(board=small), room.under(board=large))
    )
    assert np.array_equal(room.under(board=small).under(board=large).renderer.render(white), second)
    posed = room.under(board=small)
    board, camera = posed.renderer.caster.board, posed.room.camera
    x, y = np.meshgrid(np.arange(SIZES[0][0]), np.arange(SIZES[0][1]))
    _, hit = board.intersect(camera.centre, camera.rays(np.stack([x.ravel(), y.ravel()]).astype(float)))
    on = hit.reshape(x.shape).astype(np.uint8)
    inside, near = cv2.erode(on, np.ones((5, 5), np.uint8)) > 0, cv2.dilate(on, np.ones((5, 5), np.uint8)) > 0
    assert np.array_equal(first[~near], bare[~near])
    squares = np.quantile(first[inside], [0.1, 0.9])
    assert 0.03 < squares[0] / squares[1] < 0.1  # the room would shine through black squares


def test_rays_meet_the_board_which_is_slightly_bent(room: SimulatedRoom) -> None:
    camera, projector = room.room.camera, room.room.projector
    board = draw_board(BoardSettings(square_m=0.06, bend=0.01), 1, camera, projector, room.room.scene)
    uv = np.random.default_rng(0).uniform(-1, 1, (2, 50)) * board.half[:, None]
    points = board.points(uv)
    met, hit = board.intersect(camera.centre, points - camera.centre[:, None])
    assert hit.all()
    assert np.abs(met - uv).max() < 1e-9
    heights = (board.rotation.T @ (points - board.middle[:, None]))[2]
    assert 1e-4 < np.abs(heights).max() < 0.05
    assert np.allclose(np.linalg.norm(board.normals(uv), axis=0), 1)


def test_poses_differ_and_the_board_stays_the_same(room: SimulatedRoom) -> None:
    first, again, other = (
        draw_board(BoardSettings(square_m=0.06, pose=pose), 0, room.room.camera, room.room.projector, room.room.scene)
        for pose in (0, 0, 1)
    )
    assert np.array_equal(first.middle, again.middle)
    assert np.linalg.norm(first.middle - other.middle) > 0.01
    assert np.array_equal(first.bend, other.bend)


def test_a_board_outside_both_views_is_refused(room: SimulatedRoom) -> None:
    settings = BoardSettings(square_m=0.06, columns=50, rows=3)
    hidden = room.room.projector
    turned = type(hidden)(hidden.optics, -hidden.rotation, hidden.centre)
    with pytest.raises(DeviceError, match="sees no chessboard"):
        draw_board(settings, 0, room.room.camera, turned, room.room.scene)


def test_a_charuco_board_lies_on_the_floor_in_both_views(room: SimulatedRoom) -> None:
    settings = BoardSettings(kind="charuco", columns=5, rows=4, square_m=0.08, on_floor=True)
    camera, projector = room.room.camera, room.room.projector
    board = draw_board(settings, 0, camera, projector, room.room.scene)
    points = board.points(board.corners.T)
    assert board.corners.shape == (12, 2)
    assert np.abs(points[2]).max() < 1e-3
    for device in (camera, projector):
        pixels, depths = device.project(points)
        assert device.optics.sees(pixels).all()
        assert (depths > 0).all()
    assert np.all(board.normals(board.corners.T)[2] > 0.99)
    # Two squares of a ChArUco board's first row: one black, one white with the first marker in its middle.
    first = (np.array([[0.5, 1.02], [0.5, 0.5]]) - np.array([[2.5], [2.0]])) * settings.square_m
    assert board.albedo(first)[0] < board.albedo(first)[1]


def test_a_charuco_board_that_fits_nowhere_is_refused(room: SimulatedRoom) -> None:
    settings = BoardSettings(kind="charuco", columns=9, rows=9, square_m=0.3, on_floor=True)
    with pytest.raises(DeviceError, match="sees no charuco"):
        draw_board(settings, 0, room.room.camera, room.room.projector, room.room.scene)
