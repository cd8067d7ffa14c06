"""Small rotations of camera or projector: the shifts of coordinates that they cause, and their robust fit."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints, compiled, median
from scanner.decoding.significance import HUBER_ROUNDS, HUBER_SIGMAS

# Parameters of each device: shifts to the right and down, a roll and a change of scale.
PER_DEVICE = 4
COLUMNS = 2 * PER_DEVICE
# Focal length of an ordinary lens, in widths of the image. It matters in the corners only.
_FOCAL_OF_WIDTH = 1.2
# Prior standard deviation, which keeps unobservable parameters small.
PRIOR_PX = 1.0


@dataclass(frozen=True)
class Fit:
    """The `motion` (8,) of projector and camera, their `covariance`, and the decrease of χ², `gained`.

    For each device: shifts, roll and change of scale, in its px (roll and scale: at half the width from the centre).
    """

    motion: Floats
    covariance: Floats
    gained: float

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
    one = np.ones_like(x)
    horizontal = np.stack([one + x * x, x * y, -y * roll, x * roll], axis=1)
    vertical = np.stack([x * y, one + y * y, x * roll, y * roll], axis=1)
    return np.stack([horizontal, vertical], axis=1)


def fit_motion(design: Floats, seen_px: Floats, precision: Floats, row: Ints, group: Ints) -> Fit:
    """Fit the motion to `seen_px` (M,) = `design` (R, 8)[`row` (M,)] · motion, with `precision` (M,), robustly (Huber).

    Correlated errors within a `group` (R,) of rows are included in the covariance.
    """
    prior = np.eye(COLUMNS) / PRIOR_PX**2
    if not len(seen_px):
        return Fit(np.zeros(COLUMNS), PRIOR_PX**2 * np.eye(COLUMNS), 0.0)
    design, weight, root = np.ascontiguousarray(design), precision.copy(), np.sqrt(precision)
    residual, off = np.empty((2, len(seen_px)))
    for _ in range(HUBER_ROUNDS):
        information, towards = _normal_equations(design, *_sums_of_rows(row, weight, seen_px, len(design)))
        information += prior
        motion = np.linalg.solve(information, towards).astype(np.float64)
        _note_residuals(seen_px, design @ motion, row, root, residual, off)
        scale = max(SIGMA_PER_MEDIAN * median(off), 1e-3)
        _weigh_down(precision, off, HUBER_SIGMAS * scale, weight)
    _, scores = _sums_of_rows(row, weight, residual, len(design))
    sums = np.stack([np.bincount(group, column * scores) for column in design.T], axis=1)
    inverse = np.linalg.inv(information)
    covariance = inverse @ (sums.T @ sums) @ inverse + inverse * scale**2
    gained = float(np.sum(weight * (seen_px**2 - residual**2))) / scale**2
    return Fit(motion, covariance, gained)


@compiled
def _sums_of_rows(row: Ints, weight: Floats, values: Floats, rows: int) -> tuple[Floats, Floats]:
    """Return the sums of the weights (M,) and of the weighted values (M,) of each row."""
    of_weights, of_values = np.zeros(rows), np.zeros(rows)
    for i in range(len(row)):
        of_weights[row[i]] += weight[i]
        of_values[row[i]] += weight[i] * values[i]
    return of_weights, of_values


@compiled
def _normal_equations(design: Floats, weight: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the normal matrix (8, 8) and right-hand side of rows (R, 8), weights (R,) and weighted values (R,)."""
    count = design.shape[1]
    matrix, right = np.zeros((count, count)), np.zeros(count)
    for r in range(len(design)):
        for a in range(count):
            weighted = weight[r] * design[r, a]
            right[a] += values[r] * design[r, a]
            for b in range(count):
                matrix[a, b] += weighted * design[r, b]
    return matrix, right


@compiled
def _note_residuals(seen: Floats, expected: Floats, row: Ints, root: Floats, residual: Floats, off: Floats) -> None:
    """Fill the residuals (M,), and their absolute values in standard deviations."""
    for i in range(len(seen)):
        residual[i] = seen[i] - expected[row[i]]
        off[i] = abs(residual[i]) * root[i]


@compiled
def _weigh_down(precision: Floats, off: Floats, from_here: float, weight: Floats) -> None:
    """Fill the Huber weights (M,)."""
    for i in range(len(weight)):
        weight[i] = precision[i] * min(1.0, from_here / max(off[i], 1e-9))
