"""Small rotations of camera or projector: the shifts of coordinates that they cause, and their robust fit."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from calib.numerics import Floats, Ints, fit_huber
from scanner.decoding.significance import HUBER_ROUNDS, HUBER_SIGMAS

# Parameters of each device: shifts to the right and down, a roll and a change of scale.
PER_DEVICE = 4
COLUMNS = 2 * PER_DEVICE
# Focal length of an ordinary lens, in widths of the image. It matters in the corners only.
_FOCAL_OF_WIDTH = 1.2
# Prior standard deviation, which keeps unobservable parameters small.
PRIOR_PX = 1.0


@dataclass(frozen=True)
class RigidFit:
    """A motion of projector and camera. For each device: shifts, roll and change of scale, in its px (roll and scale:
    at half the width from the centre).
    """

    motion: Floats
    """(8,): of the projector, then of the camera."""
    covariance: Floats
    """(8, 8)"""
    gained: float
    """Decrease of χ²."""

    @property
    def significance(self) -> float:
        """Distance of the motion from zero, in standard deviations."""
        return sqrt(max(float(self.motion @ np.linalg.solve(self.covariance, self.motion)), 0.0))


def shifts_by_motion(
    camera_px: Floats, projector_px: Floats, gradient: Floats, camera_size: tuple[int, int], size: tuple[int, int]
) -> Floats:
    """Return the derivative (P, 2, 8) of the coordinates of pixels (P, 2) by each part of the motion.

    `gradient` (P, 2, 2): derivative of the projector coordinates (rows) by camera x and y. Sizes are (width, height).
    """
    by_motion = np.zeros((len(camera_px), 2, COLUMNS))
    # A picture that moves to the right takes its coordinates along: a fixed point sees those from further left.
    by_motion[:, :, :PER_DEVICE] = -_of_picture(projector_px, size)
    by_motion[:, :, PER_DEVICE:] = -gradient @ _of_picture(camera_px, camera_size)
    return by_motion


def _of_picture(px: Floats, size: tuple[int, int]) -> Floats:
    """Return the shifts (P, 2, 4) of a picture at pixels (P, 2) when its device pans, tilts, rolls or zooms."""
    half, focal = size[0] / 2, _FOCAL_OF_WIDTH * size[0]
    x, y = ((px - (np.array(size) - 1) / 2) / focal).T
    roll = focal / half
    ones = np.ones_like(x)
    horizontal = np.stack([ones + x * x, x * y, -y * roll, x * roll], axis=1)
    vertical = np.stack([x * y, ones + y * y, x * roll, y * roll], axis=1)
    return np.stack([horizontal, vertical], axis=1)


def fit_motion(design: Floats, seen_px: Floats, precision: Floats, group: Ints) -> RigidFit:
    """Fit the motion to `seen_px` (R,) = `design` (R, 8) · motion, with `precision` (R,), robustly (Huber).

    Correlated errors within a `group` (R,) of rows are included in the covariance.
    """
    root = np.sqrt(precision)
    expected, at_rest = np.eye(COLUMNS) / PRIOR_PX, np.zeros(COLUMNS)
    terms = np.concatenate([(design * root[:, None]).T, expected], axis=1)
    fit = fit_huber(terms, np.append(seen_px * root, at_rest), HUBER_SIGMAS, HUBER_ROUNDS)
    return RigidFit(
        fit.parameters, fit.covariance(np.append(group, np.max(group, initial=-1) + 1 + np.arange(COLUMNS))), fit.gained
    )
