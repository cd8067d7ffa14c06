"""Captures of a printed board by a synthetic rig, small enough for hundreds of them."""

from pathlib import Path

import cv2
import numpy as np
import yaml

from calib.geometry import Calibration, Intrinsics, Pose
from calib.numerics import Floats
from scanner.boards import draw_target
from scanner.io import write_png
from scanner.patterns import pattern_to_dict, sequence_for
from scanner.targets import Target

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
