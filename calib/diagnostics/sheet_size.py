"""The size of a flat sheet with known points (a ChArUco board) according to a calibration, with its uncertainty.

The camera's rays to the known points are intersected with the plane through the matches on the sheet. A similarity
compares the intersections with the known coordinates (Umeyama 1991, IEEE PAMI 13, 376).
"""

from dataclasses import dataclass

import numpy as np

from calib.diagnostics.error_propagation import LinearFit, SystematicErrors, spread_of_fit
from calib.diagnostics.uncertainty import Uncertainty, moved_calibration
from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats, blocks
from calib.pointcloud import FittedPlane, fit_plane
from calib.refinement import SHARED

_ALIKE_OF_WIDTH = 1 / 64  # errors of neighbours within this share of the picture correlate
_MOST_MATCHES = 20_000
_STEP = 1e-4  # of the plane's tilts, in radians, and of its distance as a share
_LEAST_STEP = 1e-6  # of a column


@dataclass(frozen=True)
class SheetSize:
    """The logarithm of the length of one unit of the sheet's coordinates, in the calibration's unit.

    `noise`: its standard deviation by matches and points; `by_columns` (21,): its derivatives by the calibration.
    """

    log_length: float
    noise: float
    by_columns: Floats


def size_of_sheet(
    points: Floats, pixels: Floats, matches: Matches, calibration: Calibration, uncertainty: Uncertainty | None
) -> SheetSize:
    """Measure a sheet from its `points` (N, 2), their camera `pixels` (N, 2), and the `matches` on it.

    Raises ValueError if the matches are not a plane in front of the devices.
    """
    part = matches[:: max(1, len(matches) // _MOST_MATCHES)]
    part = part[np.flatnonzero(intersect(part, calibration).in_front)]
    if len(part) < 3:
        raise ValueError("the matches on the board are not in front of the devices")
    cluster = blocks(
        np.rint(part.camera_px).astype(np.int64), max(1, round(calibration.camera.width * _ALIKE_OF_WIDTH))
    )
    plane = fit_plane(intersect(part, calibration).points, cluster)
    on_plane = _on_plane(points, pixels, plane.normal, plane.offset, calibration)
    fit = LinearFit(plane.influence, np.broadcast_to(plane.normal, (len(part), 3)), plane.covariance, cluster)
    spread = spread_of_fit(fit, part, SystematicErrors.of(calibration, None))
    by_plane = _by_plane(points, pixels, plane, calibration)
    noise = np.sqrt(on_plane.noise**2 + by_plane @ (spread.scatter + spread.smooth) @ by_plane)
    by_columns = np.zeros(SHARED)
    if uncertainty is not None:
        for column, sigma in enumerate(np.sqrt(uncertainty.covariance.diagonal())):
            step = np.zeros(SHARED)
            step[column] = max(0.1 * sigma, _LEAST_STEP)
            ahead, behind = (
                _through(points, pixels, part, plane, moved_calibration(calibration, uncertainty, sign * step))
                for sign in (1, -1)
            )
            by_columns[column] = (ahead - behind) / (2 * step[column])
    return SheetSize(on_plane.log_length, float(noise), by_columns)


def _through(points: Floats, pixels: Floats, matches: Matches, plane: FittedPlane, calibration: Calibration) -> float:
    """The logarithm of the length by another calibration, with the matches weighted as they were."""
    shift = plane.influence @ ((intersect(matches, calibration).points - plane.centre) @ plane.normal - plane.residual)
    normal, offset = _moved(plane, shift)
    return _on_plane(points, pixels, normal, offset, calibration).log_length


def _moved(plane: FittedPlane, step: Floats) -> tuple[Floats, float]:
    """Normal and offset of a plane after a step (3,) of its two tilts and its shift."""
    normal = plane.normal - step[:2] @ plane.tangents
    offset = float(normal @ plane.centre + step[2])
    length = float(np.linalg.norm(normal))
    return normal / length, offset / length


def _by_plane(points: Floats, pixels: Floats, plane: FittedPlane, calibration: Calibration) -> Floats:
    """Derivatives (3,) of the logarithm of the length by the plane's parameters."""
    gradient = np.zeros(3)
    for index, size in enumerate((_STEP, _STEP, _STEP * abs(plane.offset))):
        step = np.zeros(3)
        step[index] = size
        ahead, behind = (
            _on_plane(points, pixels, *_moved(plane, sign * step), calibration).log_length for sign in (1, -1)
        )
        gradient[index] = (ahead - behind) / (2 * size)
    return gradient


def _on_plane(points: Floats, pixels: Floats, normal: Floats, offset: float, calibration: Calibration) -> SheetSize:
    """The size on a given plane, with noise by the points' residuals of the similarity."""
    rays = calibration.camera.unproject(pixels)
    met = rays * (offset / (rays @ normal))[:, None]
    known, measured = points - points.mean(axis=0), met - met.mean(axis=0)
    u, singular, right = np.linalg.svd(known.T @ measured, full_matrices=False)
    size = float(np.sum(known**2))
    scale = float(singular.sum()) / size
    left_over = measured - scale * known @ u @ right
    # Four parameters were fitted; both coordinates on the plane have the same variance.
    variance = float(np.sum(left_over**2)) / max(2 * len(points) - 4, 1)
    return SheetSize(float(np.log(scale)), float(np.sqrt(variance / size)) / scale, np.zeros(SHARED))
