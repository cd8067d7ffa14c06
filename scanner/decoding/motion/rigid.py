"""Small turns of the camera or the projector, as shifts of the coordinates that pixels see, fitted to these."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints, compiled, median
from scanner.decoding.significance import HUBER_SIGMAS

# Of each device: shifts of its picture to the right and down, a roll and a change of scale.
PER_DEVICE = 4
COLUMNS = 2 * PER_DEVICE
# An ordinary lens: the focal length in widths of the image. It matters in the corners of the picture only.
_FOCAL_OF_WIDTH = 1.2
# What no pixel tells of stays small.
_PRIOR_PX = 1.0
_ROUNDS = 6


@dataclass(frozen=True)
class Fit:
    """Shifts, roll and scale of projector and camera, `motion` (8,) in px of each device (roll and scale: at half the
    picture's width from its centre), with their `covariance`; `gained`: by how much χ² falls.
    """

    motion: Floats
    covariance: Floats
    gained: float

    @property
    def significance(self) -> float:
        """How many standard deviations the motion is from none."""
        return sqrt(max(float(self.motion @ np.linalg.solve(self.covariance, self.motion)), 0.0))


def shifts_by_motion(
    camera_px: Floats, projector_px: Floats, gradient: Floats, camera_size: tuple[int, int], size: tuple[int, int]
) -> Floats:
    """By how much the coordinates of pixels (P, 2) change, (P, 2, 8), per px of each part of the motion.

    `gradient` (P, 2, 2): of the projector's coordinates (rows) by camera x and y. Sizes are (width, height).
    """
    by_motion = np.zeros((len(camera_px), 2, COLUMNS))
    # A picture that moves to the right takes its coordinates along: a place sees those from further left.
    by_motion[:, :, :PER_DEVICE] = -_of_picture(projector_px, size)
    by_motion[:, :, PER_DEVICE:] = -gradient @ _of_picture(camera_px, camera_size)
    return by_motion


def _of_picture(px: Floats, size: tuple[int, int]) -> Floats:
    """How a picture moves at pixels (P, 2), (P, 2, 4), when its device turns up and down, sideways, rolls, or zooms."""
    half, focal = size[0] / 2, _FOCAL_OF_WIDTH * size[0]
    x, y = ((px - (np.array(size) - 1) / 2) / focal).T
    roll = focal / half
    one = np.ones_like(x)
    horizontal = np.stack([one + x * x, x * y, -y * roll, x * roll], axis=1)
    vertical = np.stack([x * y, one + y * y, x * roll, y * roll], axis=1)
    return np.stack([horizontal, vertical], axis=1)


def fit_motion(design: Floats, seen_px: Floats, precision: Floats, row: Ints, group: Ints) -> Fit:
    """Robust least squares of the motion in `seen_px` (M,) = `design` (R, 8)[`row` (M,)] · motion, each with a
    `precision` (M,).

    What the rows of a `group` (R,) have in common that is no motion shows in the covariance.
    """
    prior = np.eye(COLUMNS) / _PRIOR_PX**2
    if not len(seen_px):
        return Fit(np.zeros(COLUMNS), _PRIOR_PX**2 * np.eye(COLUMNS), 0.0)
    design, weight, root = np.ascontiguousarray(design), precision.copy(), np.sqrt(precision)
    residual, off = np.empty((2, len(seen_px)))
    for _ in range(_ROUNDS):
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
    """Sums of the weights (M,), and of the values (M,) times these, of each row."""
    of_weights, of_values = np.zeros(rows), np.zeros(rows)
    for i in range(len(row)):
        of_weights[row[i]] += weight[i]
        of_values[row[i]] += weight[i] * values[i]
    return of_weights, of_values


@compiled
def _normal_equations(design: Floats, weight: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Of rows (R, 8) with weights (R,), and weights times values (R,): the matrix (8, 8), and the right-hand side."""
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
    """What is seen beside what is expected of a row, all (M,), and how many standard deviations that is."""
    for i in range(len(seen)):
        residual[i] = seen[i] - expected[row[i]]
        off[i] = abs(residual[i]) * root[i]


@compiled
def _weigh_down(precision: Floats, off: Floats, from_here: float, weight: Floats) -> None:
    """Less weight to what is farther off, (M,) (Huber)."""
    for i in range(len(weight)):
        weight[i] = precision[i] * min(1.0, from_here / max(off[i], 1e-9))
