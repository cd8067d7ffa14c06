"""COLMAP's solution of two photos by one unknown camera, with its principal point fixed or free."""

import numpy as np
from colmap_two_view import HAS_COLMAP, two_views, unknown_focal

from calib.geometry import Matches

HELD, FREE = "PP at the centre", "PP free"
PEERS = (HELD, FREE) if HAS_COLMAP else ()


def two_view(matches: Matches, size: tuple[int, int], peer: str) -> np.ndarray | None:
    """(f, x_0, y_0) in pixels, in this project's convention of pixel centres; None if COLMAP finds no solution."""
    found = two_views(matches, unknown_focal(*size, ((size[0] - 1) / 2, (size[1] - 1) / 2)), None)
    if found is None:
        return None
    found.adjust(free_principal_point=peer == FREE)
    camera = found.calibration.camera
    return np.array([camera.focal_px[0], *camera.principal_point_px])
