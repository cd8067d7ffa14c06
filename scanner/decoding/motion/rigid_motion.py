"""Rigid motion of projector and camera: eight parameters, the shifts that they cause, and their robust fit.

The parameters are, for the projector and then for the camera: shifts to the right and down, a roll and a change of
scale, in px of the device (roll and scale: at half the width from the centre).
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from calib.numerics import MEDIAN_LENGTH, STRIP_ROWS, Floats, Floats32, Ints, clustered_scatter, huber_weights
from scanner.decoding.significance import HALF, HUBER_ROUNDS, HUBER_SIGMAS

PER_DEVICE = 4
COLUMNS = 2 * PER_DEVICE
# Focal length of an ordinary lens, in widths of the image. It matters in the corners only.
_FOCAL_OF_WIDTH = 1.2
# Prior standard deviation, which keeps unobservable parameters small.
PRIOR_PX = 1.0


def shifts_by_motion(
    camera_px: Floats, projector_px: Floats, gradient: Floats, camera_size: tuple[int, int], size: tuple[int, int]
) -> Floats:
    """Return the derivative (P, 2, 8) of the coordinates of pixels (P, 2) by each part of the motion.

    `gradient` (P, 2, 2): derivative of the projector coordinates (rows) by camera x and y. Sizes are (width, height).
    """
    by_motion = np.zeros((len(camera_px), 2, COLUMNS))
    # A picture that moves to the right takes its coordinates along: a fixed point sees those from further left.
    by_motion[:, :, :PER_DEVICE] = -shifts_of_picture(projector_px, size)
    by_motion[:, :, PER_DEVICE:] = -gradient @ shifts_of_picture(camera_px, camera_size)
    return by_motion


def shifts_of_picture(px: Floats, size: tuple[int, int]) -> Floats:
    """Return the shifts (P, 2, 4) of a picture at pixels (P, 2) when its device pans, tilts, rolls or zooms."""
    half, focal = size[0] / 2, _FOCAL_OF_WIDTH * size[0]
    x, y = ((px - (np.array(size) - 1) / 2) / focal).T
    roll = focal / half
    ones = np.ones_like(x)
    horizontal = np.stack([ones + x * x, x * y, -y * roll, x * roll], axis=1)
    vertical = np.stack([x * y, ones + y * y, x * roll, y * roll], axis=1)
    return np.stack([horizontal, vertical], axis=1)


@dataclass(frozen=True)
class RigidFit:
    """A motion of projector and camera, fitted to what is seen."""

    motion: Floats
    """(8,)"""
    covariance: Floats
    """(8, 8)"""
    gained: float
    """Decrease of χ²."""

    @property
    def significance(self) -> float:
        """Distance of the motion from zero, in standard deviations."""
        return sqrt(max(float(self.motion @ np.linalg.solve(self.covariance, self.motion)), 0.0))


def fit_motion(
    design: Floats,
    seen: Floats,
    cluster: Ints,
    prior_px: Floats | float = PRIOR_PX,
    limit: float = HUBER_SIGMAS,
    least_scale: float = 0.0,
) -> RigidFit:
    """Fit the motion to the shifts `seen` (R, 2) = `design` (R, 2, 8) · motion, in standard deviations, robustly.

    Huber's weight of a shift falls beyond `limit` times their scatter, which is taken as `least_scale` at least.
    Correlated errors within a `cluster` (R,), labels from 0, are included in the covariance.
    """
    prior = np.diag(np.broadcast_to(1.0 / np.square(prior_px), COLUMNS))
    rows, weight = design.reshape(-1, COLUMNS), np.ones(len(design))
    for _ in range(HUBER_ROUNDS):
        weighted = (weight[:, None, None] * design).reshape(-1, COLUMNS).T
        information = weighted @ rows
        motion = np.linalg.solve(information + prior, weighted @ seen.reshape(-1)).astype(np.float64)
        residual = seen - (rows @ motion).reshape(-1, 2)
        size = np.hypot(*residual.T)
        scale = max(float(np.median(size)) / MEDIAN_LENGTH, least_scale) if len(size) else max(least_scale, 1.0)
        weight = huber_weights(size, limit * scale)
    scores = weight[:, None] * np.einsum("rka,rk->ra", design, residual)
    inverse = np.linalg.inv(information + prior)
    covariance = inverse @ (clustered_scatter(scores, cluster) + scale**2 * information + prior) @ inverse
    gained = float(weight @ (np.sum(seen**2, axis=1) - size**2)) / scale**2 if len(size) else 0.0
    return RigidFit(motion, covariance, gained)


@dataclass(frozen=True)
class CoordinateShift:
    """The mean motion of both devices in the x and y coordinates; sizes are (width, height)."""

    motions: Floats
    """(2, 8): of x and of y."""
    camera_size: tuple[int, int]
    """Of the camera's picture."""
    projector_size: tuple[int, int]
    """Of the projector's picture."""

    def shifts(self, camera_px: Floats, projector_px: Floats, gradient: Floats) -> Floats:
        """Return the shifts (N, 2) of matches at camera px (N, 2) and projector px (N, 2).

        `gradient` (N, 2, 2): derivative of the projector coordinates (rows) by camera x and y.
        """
        by_motion = shifts_by_motion(camera_px, projector_px, gradient, self.camera_size, self.projector_size)
        shifts: Floats = np.einsum("nac,ac->na", by_motion, self.motions)
        return shifts

    def subtracted_from(self, projector_px: Floats32) -> Floats32:
        """Return a map of projector coordinates (H, W, 2) less the shifts, with the gradient of the map."""
        height, width, _ = projector_px.shape
        before, result = np.pad(projector_px, ((1, 1), (1, 1), (0, 0)), mode="edge"), np.empty_like(projector_px)
        for top in range(0, height, STRIP_ROWS):
            rows = slice(top, min(top + STRIP_ROWS, height))
            around = before[rows.start : rows.stop + 2]
            by_x, by_y = around[1:-1, 2:] - around[1:-1, :-2], around[2:, 1:-1] - around[:-2, 1:-1]
            gradient = np.nan_to_num(np.stack([by_x, by_y], axis=3) / 2).reshape(-1, 2, 2)
            y, x = np.mgrid[rows, :width]
            camera_px = np.stack([x.reshape(-1), y.reshape(-1)], axis=1)
            here = projector_px[rows].reshape(-1, 2).astype(np.float64)
            result[rows] = projector_px[rows] - self.shifts(camera_px, here, gradient).reshape(-1, width, 2)
        return result


def turns_px(motion: Floats) -> tuple[float, float]:
    """Return how far the projector's picture moved, and the camera's, each in its own px."""
    projector, camera = (float(np.hypot(*part[:2])) for part in np.split(motion, [PER_DEVICE]))
    return projector, camera


def moved_device(motion: Floats, size: str = "{:.2g} px") -> str:
    """Describe which device moved, for example: the projector moved by 1.2 px; `motion` (8,), `size`: format of px."""
    projector, camera = turns_px(motion)
    moved = [
        f"the {device} moved by {size.format(px)}"
        for device, px, other_px in (("projector", projector, camera), ("camera", camera, projector))
        if px >= HALF * other_px
    ]
    return " and ".join(moved)
