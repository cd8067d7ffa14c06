"""COLMAP on the two views of a rig, in the paper's four variants."""

from dataclasses import replace

import numpy as np
from colmap_two_view import TwoViews, two_views, unknown_focal

from calib.geometry import Calibration, Matches
from paper.published import RANDOM_START_SHORT_BY

_ADJUSTMENTS = 10  # COLMAP's end before they have converged
MATCHES = 10_000  # matches per capture for COLMAP: its time grows with them, its error does not depend on them


def centre_start(truth: Calibration) -> tuple[float, float]:
    """C: the projector's principal point at its image's centre."""
    return (truth.projector.width - 1) / 2, (truth.projector.height - 1) / 2


def paper_start(truth: Calibration) -> tuple[float, float]:
    """R: the paper's own random start, from its table."""
    x, y = np.array(truth.projector.principal_point_px) * (1 - np.array(RANDOM_START_SHORT_BY))
    return float(x), float(y)


def drawn_start(truth: Calibration, rng: np.random.Generator) -> tuple[float, float]:
    """R: a random point in the projector's image."""
    x, y = rng.uniform(0, truth.projector.size)
    return float(x), float(y)


def variants(
    matches: Matches, truth: Calibration, start_px: tuple[float, float]
) -> tuple[Calibration | None, Calibration | None]:
    """Errors without and with the additional bundle adjustment; None where COLMAP finds no solution.

    The camera's principal point is the true one. Focal lengths start at COLMAP's default and are adjusted with fixed
    principal points; the additional adjustment frees both principal points together, as COLMAP does.
    """
    camera = unknown_focal(*truth.camera.size, truth.camera.principal_point_px)
    found = two_views(matches, camera, unknown_focal(*truth.projector.size, start_px))
    if found is None:
        return None, None
    results: list[Calibration | None] = []
    for free in (False, True):
        found.adjust(free_principal_point=free)
        results.append(_calibration_of(found))
    return results[0], results[1]


def with_known_points(matches: Matches, truth: Calibration, *, from_truth: bool) -> Calibration | None:
    """COLMAP's solution with both true principal points, adjusted until it converges; None if it finds none.

    It starts at COLMAP's default focal lengths, or at the true ones.
    """
    devices = [
        replace(device, distortion=(0.0,) * 5) if from_truth else unknown_focal(*device.size, device.principal_point_px)
        for device in (truth.camera, truth.projector)
    ]
    found = two_views(matches, *devices)
    if found is None:
        return None
    for _ in range(_ADJUSTMENTS):
        found.adjust(free_principal_point=False)
    return _calibration_of(found)


def _calibration_of(found: TwoViews) -> Calibration | None:
    try:
        return found.calibration
    except ValueError as error:
        print(f"    COLMAP ran off: {error}")
        return None
