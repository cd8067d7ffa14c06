"""Faces without the margin in which the lens mixes them with their surroundings.

A camera pixel sees the mean over its footprint. Across a crease or an edge, this is the coordinate of neither surface.
The error is below the noise, but always has the same sign, so that a calibration would follow it.
"""

from math import ceil, sqrt

import cv2
import numpy as np

from calib.geometry import FACES, NO_FACE, Matches

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
