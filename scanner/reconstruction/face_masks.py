"""Hand-drawn faces: three PNG of the size of the camera, nonzero on the face, as in the paper; and faces without the
margin in which the lens mixes them with their surroundings.
"""

from itertools import combinations
from math import ceil, sqrt
from pathlib import Path

import cv2
import numpy as np

from calib.geometry import FACES, NO_FACE, Matches, Size
from calib.numerics import Bools
from scanner.errors import InputError
from scanner.io import read_image


def read_masks(folder: Path, camera_size: Size) -> Bools:
    """The masks (3, H, W) of the faces 0, 1, 2 in the order of their file names.

    Raises InputError unless the folder holds exactly three PNG of `camera_size`, none empty and no
    two overlapping.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: {'not a folder' if folder.exists() else 'no such folder of masks'}")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".png" and not path.name.startswith("."))
    if len(paths) != 3:
        names = ", ".join(path.name for path in paths) or "none"
        raise InputError(f"{folder}: expected three PNG, one for each face, found {len(paths)}: {names}")
    masks = np.stack([_read_mask(path, camera_size) for path in paths])
    for (a, first), (b, second) in combinations(enumerate(paths), 2):
        shared = int(np.count_nonzero(masks[a] & masks[b]))
        if shared:
            raise InputError(
                f"{folder}: {first.name} and {second.name} overlap in {shared} pixels: a pixel is on one face only"
            )
    return masks


def _read_mask(path: Path, camera_size: Size) -> Bools:
    image = read_image(path, camera_size)
    if Size.of(image) != camera_size:
        raise InputError(f"{path}: expected the camera's size, {camera_size}, found {Size.of(image)}")
    mask: Bools = (image if image.ndim == 2 else image.max(axis=2)) > 0
    if not mask.any():
        raise InputError(f"{path}: every pixel is zero: the face should be painted in any other colour")
    return mask


def label_by_masks(matches: Matches, masks: Bools) -> Matches:
    """The matches with the face (0, 1, 2) whose mask (3, H, W) covers their camera pixel."""
    _, height, width = masks.shape
    column, row = np.rint(matches.camera_px).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    labels = np.full((height, width), NO_FACE, np.int32)
    for label, mask in enumerate(masks):
        labels[mask] = label
    face = np.full(len(matches), NO_FACE, np.int32)
    face[inside] = labels[row[inside], column[inside]]
    return matches.with_faces(face)


# Footprints are Gaussian: beyond two standard deviations lie 2 % of the light.
_SIGMAS = 2.0
# Pixels next to an edge are masked anyway, or are good if the lens is sharp.
_LEAST_PX = 2.0


def without_margins(matches: Matches, camera_size: tuple[int, int], footprint_px2: float) -> Matches:
    """The matches, of which those too close to the face's border for a footprint of this variance lose their face."""
    reach_px = _SIGMAS * sqrt(footprint_px2)
    if reach_px < _LEAST_PX or matches.face is None:
        return matches
    width, height = camera_size
    column, row = np.rint(matches.camera_px).astype(np.int64).T
    size = 2 * ceil(reach_px) + 1
    footprint = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    face = np.full(len(matches), NO_FACE, np.int32)
    for number in FACES:
        on_face = np.zeros((height, width), np.uint8)
        on_face[row[matches.face == number], column[matches.face == number]] = 1
        # A pixel without a match is not a border by itself.
        whole = cv2.morphologyEx(on_face, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        inner = cv2.erode(whole, footprint) > 0
        face[(matches.face == number) & inner[row, column]] = number
    return matches.with_faces(face)
