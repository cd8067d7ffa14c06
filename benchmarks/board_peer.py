"""The usual calibration from boards: local homographies at the corners, then OpenCV's stereoCalibrate.

D. Moreno and G. Taubin, Simple, accurate, and robust projector-camera calibration, 3DIMPVT 2012; with the thresholds
and windows of the script in github.com/kamino410/procam-calibration.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calib.geometry import homography_between, mapped
from calib.numerics import Floats
from scanner.capture import open_capture
from scanner.patterns import Black, Gray, White

_BLACK, _WHITE = 40, 5  # grey levels: white over black, and a bit over its inverse
_WINDOWS = 180  # windows side by side in an image's width, twice over


@dataclass(frozen=True)
class Corners:
    """One board: `points` (N, 2), and their pixels in both devices, (N, 2) each."""

    points: Floats
    camera_px: Floats
    projector_px: Floats


@dataclass(frozen=True)
class Peer:
    """OpenCV's models of both devices; X_projector = R X_camera + t. `rms`: of camera, projector, and both."""

    camera: tuple[Floats, Floats]
    projector: tuple[Floats, Floats]
    rotation: Floats
    translation: Floats
    rms: tuple[float, float, float]


def corners_of(folder: Path, points: Floats, counts: tuple[int, int]) -> Corners:
    """Corners of a Gray code capture: its pixels by OpenCV's decoder, its corners by OpenCV's older detector."""
    recording = open_capture(folder)
    images = {pattern: frame.image.astype(np.int32) for pattern, frame in recording.stream().frames}
    white = images[White()]
    known = white - images[Black()] > _BLACK
    coordinates = []
    for axis in ("x", "y"):
        word, number = np.zeros(white.shape, np.int64), np.zeros(white.shape, np.int64)
        bits = sorted((p for p in images if isinstance(p, Gray) and p.axis == axis), key=lambda p: (p.bit, p.inverted))
        for bit, inverse in zip(bits[::2], bits[1::2], strict=True):
            difference = images[bit] - images[inverse]
            known &= np.abs(difference) >= _WHITE
            word = (difference > 0) ^ (word & 1)
            number = 2 * number + word
        coordinates.append(number)
    _, corners = cv2.findChessboardCorners(white.astype(np.uint8), counts)
    camera_px = np.asarray(corners, np.float64).reshape(-1, 2)
    there = np.stack(coordinates, axis=-1).astype(np.float64)
    return _local(points, camera_px, known, there, int(np.ceil(white.shape[1] / _WINDOWS)))


def _local(points: Floats, camera_px: Floats, known: np.ndarray, there: Floats, half: int) -> Corners:
    kept, projector_px = [], []
    for i, corner in enumerate(camera_px):
        column, row = np.rint(corner).astype(int)
        window = np.s_[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        rows, columns = np.nonzero(known[window])
        if len(rows) < half**2:
            continue
        source = np.stack([columns + window[1].start, rows + window[0].start], axis=1).astype(np.float64)
        homography, _ = cv2.findHomography(source, there[window][rows, columns])
        projector_px.append(mapped(np.asarray(homography), corner[None])[0])
        kept.append(i)
    return Corners(points[kept], camera_px[kept], np.array(projector_px))


def local_corners(points: Floats, camera_px: Floats, seen: Floats, there: Floats, reach_px: float) -> Corners:
    """The same from matches (M, 2) each, those in a window around each corner."""
    kept, projector_px = [], []
    for i, corner in enumerate(camera_px):
        near = np.abs(seen - corner).max(axis=1) <= reach_px
        if np.count_nonzero(near) >= 8:
            homography = homography_between(seen[near], there[near])
            projector_px.append(mapped(homography, corner[None])[0])
            kept.append(i)
    return Corners(points[kept], camera_px[kept], np.array(projector_px))


def calibrate(boards: Sequence[Corners], camera_size: tuple[int, int], projector_size: tuple[int, int]) -> Peer:
    """Calibrate camera, projector, then both with these fixed, as the script does."""
    flat = [np.concatenate([b.points, np.zeros((len(b.points), 1))], axis=1).astype(np.float32) for b in boards]
    seen = [board.camera_px.astype(np.float32)[:, None] for board in boards]
    lit = [board.projector_px.astype(np.float32)[:, None] for board in boards]
    camera_rms, camera, bent, *_ = cv2.calibrateCamera(flat, seen, camera_size, None, None)
    projector_rms, projector, thrown, *_ = cv2.calibrateCamera(flat, lit, projector_size, None, None)
    rms, camera, bent, projector, thrown, rotation, translation, *_ = cv2.stereoCalibrate(
        flat, seen, lit, camera, bent, projector, thrown, camera_size, flags=cv2.CALIB_FIX_INTRINSIC
    )
    numbers = (np.asarray(each, np.float64) for each in (camera, bent, projector, thrown, rotation, translation))
    camera_matrix, camera_lens, projector_matrix, projector_lens, turn, place = numbers
    return Peer(
        (camera_matrix, camera_lens),
        (projector_matrix, projector_lens),
        turn,
        place.ravel(),
        (camera_rms, projector_rms, float(rms)),
    )


def predicted(peer: Peer, board: Corners, camera_px: Floats) -> Floats:
    """Projector pixels of camera pixels (N, 2) on a board whose pose comes from its corners in the camera."""
    flat = np.concatenate([board.points, np.zeros((len(board.points), 1))], axis=1)
    _, turn, place = cv2.solvePnP(flat, board.camera_px, *peer.camera, flags=cv2.SOLVEPNP_ITERATIVE)
    rotation = cv2.Rodrigues(turn)[0]
    rays = cv2.undistortPoints(camera_px[:, None].copy(), *peer.camera).reshape(-1, 2)
    rays = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    points = rays * ((rotation[:, 2] @ place.ravel()) / (rays @ rotation[:, 2]))[:, None]
    pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(peer.rotation)[0], peer.translation, *peer.projector)
    return np.asarray(pixels, np.float64).reshape(-1, 2)
