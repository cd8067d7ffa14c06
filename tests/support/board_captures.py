"""Synthetic boards, as views, as pictures and as captures, small enough for hundreds of them."""

from pathlib import Path

import cv2
import numpy as np
import yaml

from calib.boards import BoardView
from calib.estimation import into_cells
from calib.geometry import Calibration, Intrinsics, Pose, mapped
from calib.numerics import Floats
from calib.synthetic import SyntheticBoards
from scanner.boards import draw_target
from scanner.io import write_png
from scanner.patterns import pattern_to_dict, sequence_for
from scanner.targets import Target


def views_of(boards: SyntheticBoards) -> list[BoardView]:
    views = []
    for i, view in enumerate(boards.views):
        cells = into_cells(view.matches.with_faces(np.zeros(len(view.matches), np.int32)), (0,))
        views.append(BoardView(f"view {i}", view.points, view.corners_px, cells))
    return views


def photographed(target: Target, seed: int, size: tuple[int, int] = (800, 640)) -> tuple[np.ndarray, Floats]:
    """A flat board seen obliquely, blurred and noisy; and the pixels of its points, (N, 2)."""
    rng = np.random.default_rng(seed)
    side = 40
    drawn = draw_target(target, side)
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * target.reach
    angle = rng.uniform(-0.5, 0.5)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    place = half @ turn.T / target.reach * 0.33 * size[1] + np.array(size) / 2 + rng.uniform(-35, 35, (4, 2))
    homography = cv2.getPerspectiveTransform(half.astype(np.float32), place.astype(np.float32)).astype(np.float64)
    x, y = drawn.middle_px
    scale = target.square / side
    of_picture = np.array([[scale, 0, -scale * x], [0, scale, -scale * y], [0, 0, 1]])
    large = 3  # pixels average over what they see
    grown = np.array([[large, 0, (large - 1) / 2], [0, large, (large - 1) / 2], [0, 0, 1]])
    fine = cv2.warpPerspective(
        drawn.image, grown @ homography @ of_picture, (large * size[0], large * size[1]), borderValue=150
    )
    sharp = np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), np.float64)
    picture = 0.7 * cv2.GaussianBlur(sharp, (0, 0), 0.7) + 30 + rng.normal(0, 1.5, sharp.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), mapped(homography, target.points)


CAMERA = Intrinsics(320, 256, (400.0, 400.0), (163.0, 125.0), (0.0,) * 5)
PROJECTOR = Intrinsics(320, 200, (470.0, 470.0), (161.0, 190.0), (0.0,) * 5)
_PATTERNS = sequence_for(PROJECTOR.size, cell=8, periods=(16.0,), shifts=3)
_SIDE_PX = 24  # of a square as it is drawn
_DARK, _SURROUNDINGS = 12.0, 0.4


def write_board_capture(folder: Path, target: Target, rig: Calibration, pose: Pose) -> Path:
    """Write a capture of a flat board in a `pose` in the camera's frame, in the unit of `target` and `rig`."""
    board, projector_px = _seen(rig, pose)
    reflectance = _reflectance(target, board)
    (folder / "frames").mkdir(parents=True)
    frames = []
    for index, pattern in enumerate(_PATTERNS):
        lit = np.broadcast_to(pattern.brightness(projector_px[..., 0], projector_px[..., 1]), reflectance.shape)
        there = np.all((projector_px > -0.5) & (projector_px < np.array(rig.projector.size) - 0.5), axis=2)
        file = f"frames/{index:03d}.png"
        write_png(folder / file, np.rint(_DARK + 220.0 * reflectance * lit * there).astype(np.uint8))
        frames.append({"file": file, "pattern": pattern_to_dict(pattern)})
    sizes = {
        name: {"width": device.width, "height": device.height}
        for name, device in (("camera", rig.camera), ("projector", rig.projector))
    }
    (folder / "capture.yaml").write_text(yaml.safe_dump({"format": 1, **sizes, "frames": frames}))
    return folder


def _seen(rig: Calibration, pose: Pose) -> tuple[Floats, Floats]:
    """For each camera pixel, (H, W, 2): its point on the board's plane, and the projector's pixel there."""
    row, column = np.indices((rig.camera.height, rig.camera.width), dtype=np.float64)
    rays = rig.camera.unproject(np.stack([column.ravel(), row.ravel()], axis=1))
    normal = pose.rotation[:, 2]
    points = rays * (pose.translation @ normal / (rays @ normal))[:, None]
    board = (pose.inverse() @ points)[:, :2]
    projector_px = rig.projector.project(rig.pose @ points)
    return board.reshape(*row.shape, 2), projector_px.reshape(*row.shape, 2)


def _reflectance(target: Target, board: Floats) -> Floats:
    drawn = draw_target(target, _SIDE_PX)
    place = (board * (_SIDE_PX / target.square) + drawn.middle_px).astype(np.float32)
    smooth = cv2.GaussianBlur(drawn.image, (0, 0), 1.5)
    seen = cv2.remap(smooth, place, None, cv2.INTER_LINEAR, borderValue=(255 * _SURROUNDINGS,))
    return 0.08 + 0.8 * np.asarray(seen, np.float64) / 255
