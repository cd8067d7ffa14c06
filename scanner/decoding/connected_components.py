"""Find small connected components."""

import cv2
import numpy as np

from calib.numerics import Bools, in_slices, widened
from scanner.decoding.fringes.edge_shift_correction import CROSS

SMALLEST_PATCH = 24  # pixels; fewer are taken for outliers that happen to touch
_ROWS = 512  # at once, of which twice the smallest patch is searched twice
_WITHIN = np.ones((5, 5), np.uint8)  # a square of more pixels


def small_patches(image: Bools) -> Bools:
    """Return the pixels of an image (H, W) in 4-connected components of fewer than `SMALLEST_PATCH` pixels."""
    result = np.empty_like(image)

    def find(rows: slice) -> None:
        # A component that reaches beyond the widened rows is not small.
        wider, inner = widened(rows, SMALLEST_PATCH, len(image))
        part = image[wider].view(np.uint8)
        # Few pixels are not in a square that is part of their component: only these have to be connected.
        large = cv2.morphologyEx(part, cv2.MORPH_OPEN, _WITHIN, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        rest = np.subtract(part, large)
        _, labels = cv2.connectedComponents(rest, connectivity=4)
        places = np.flatnonzero(rest)
        label, beside = (of.reshape(-1)[places] for of in (labels, cv2.dilate(large, CROSS)))
        small = np.bincount(label) < SMALLEST_PATCH
        small[label[beside > 0]] = False
        rest.reshape(-1)[places] = small[label]
        result[rows] = rest[inner]

    in_slices(len(image), _ROWS, find)
    return result
