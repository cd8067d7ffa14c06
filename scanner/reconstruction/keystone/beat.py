"""A picture that is resampled, as contrasts of stripes that beat: how well a homography explains them.

Where a thin sample of pixels is on planes, and what changes smoothly over these.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.geometry import mapped
from calib.numerics import CONIC, Bools, Floats, Ints, compiled, in_pieces, monomials, orthonormal, robust_sigma
from scanner.decoding import FinestStripes

_NEAR_PX = 2
_NOBODY, _SEVERAL, _MOST_LABELS = -2, -1, 127
_FEWEST_OF_PLANE = 100
_FEWEST = 300
_OUTLIER_SIGMAS, _ROUNDS = 3.5, 4
# Amplitude of beats relative to that of linear interpolation between two pixels: 0.9 to 1.2. Other variation in real
# scenes reaches 0.6, and explains up to 2 % of the variance of simulated ones, where beats explain 9 % or more.
_LEAST_EXPLAINED, _LEAST_STRENGTH, _MOST_STRENGTH = 0.04, 0.75, 1.5
_SIGNIFICANT_SIGMAS, _LEAST_PX = 6.0, 0.5
# Reduction of the misfit, in squared sigmas, required to accept a rotation, a shear or a second keystone.
_WORTH_THE_REST = 25.0
# Residuals of a scene correlate over several pixels, however many are used.
_ALIKE, _MOST_INDEPENDENT = 4.0, 1250
# Relative changes of the misfit and of the step at which a fit has converged.
_PRECISE = 1e-5
# Parameters of a homography minus the identity, in units of half the picture's width about its middle: coefficients of
# x, y and 1 in x, in y, and of x and y in the denominator.
NUMBERS = 8
EVERYTHING = tuple(range(NUMBERS))
UPRIGHT = (0, 2, 4, 5)  # parameters without rotation and shear
LEANS = slice(6, 8)

# Shifts in pixels (N,) and a period of stripes → the logarithm of their remaining contrast.
Wave = Callable[[Floats, float], Floats]


def planes_at(pixels: Floats, camera_px: Floats, plane: Ints) -> Ints:
    """The plane of camera pixels (P, 2), if all matches around them agree; −1 otherwise.

    `camera_px` (N, 2): pixels of the matches; `plane` (N,): the plane of each, negative for none.
    """
    at, down = pixels.astype(np.int64).T
    width, height = int(at.max()) + 1, int(down.max()) + 1
    labels = np.full((height + 2 * _NEAR_PX, width + 2 * _NEAR_PX), _NOBODY, np.int8)
    in_pieces(len(plane), lambda at: _note(camera_px[at], plane[at], labels))
    near = np.stack([labels[down + i, at + j] for i in range(2 * _NEAR_PX + 1) for j in range(2 * _NEAR_PX + 1)])
    greatest = near.max(axis=0)
    agree = np.all((near == greatest) | (near == _NOBODY), axis=0)
    return np.where(agree, np.maximum(greatest, _SEVERAL), _SEVERAL).astype(np.int32)


@compiled
def _note(camera_px: Floats, plane: Ints, labels: NDArray[np.int8]) -> None:
    """Write the planes of matches (N, 2) into an image with a border; planes that exceed a byte are left out."""
    height, width = labels.shape
    for i in range(len(plane)):
        row, column = int(camera_px[i, 1] + 0.5) + _NEAR_PX, int(camera_px[i, 0] + 0.5) + _NEAR_PX
        if row < height and column < width:
            labels[row, column] = max(plane[i], _SEVERAL) if plane[i] <= _MOST_LABELS else _SEVERAL


def smooth_over(plane: Ints, points: Floats, chosen: Bools) -> tuple[Floats, Bools]:
    """An orthonormal basis (N, M) of what changes up to second order over each plane, for the chosen pixels that are on
    one of some size.
    """
    large = [number for number in np.unique(plane[chosen]) if np.sum(chosen & (plane == number)) >= _FEWEST_OF_PLANE]
    chosen = chosen & np.isin(plane, large)
    here, where = points[chosen], plane[chosen]
    columns = np.zeros((len(here), CONIC * len(large)))
    for number, label in enumerate(large):
        on = where == label
        columns[on, CONIC * number : CONIC * (number + 1)] = monomials(here[on])[:, :CONIC]
    return orthonormal(columns), chosen


def homography_of(values: Floats) -> Floats:
    """The homography (3, 3) of these numbers, in their units."""
    xx, xy, x1, yx, yy, y1, lean_x, lean_y = values
    return np.array([[1 + xx, xy, x1], [yx, 1 + yy, y1], [lean_x, lean_y, 1]])


@dataclass(frozen=True)
class BeatFit:
    """`values` (8,) and their `covariance` (8, 8), of which some were `free`.

    `explained`: share of the variance; `strengths`: amplitudes of the beats along x, y relative to those of a linear
    interpolation.
    """

    values: Floats
    covariance: Floats
    free: tuple[int, ...]
    explained: float
    strengths: tuple[float, float]

    @property
    def is_of_a_beat(self) -> bool:
        """Whether its strength along both axes, and what it explains, are typical of a beat."""
        is_as_strong = all(_LEAST_STRENGTH <= strength <= _MOST_STRENGTH for strength in self.strengths)
        return is_as_strong and self.explained >= _LEAST_EXPLAINED


@dataclass(frozen=True)
class Beat:
    """The logarithms `data` (N,) of contrasts at `points` (N, 2), in units of `half` the picture's width about its
    middle.

    The variation in `smooth` (N, M), with orthonormal columns, is removed. `wave`: the function of the beat.
    """

    points: Floats
    data: Floats
    smooth: Floats
    size: tuple[int, int]
    periods: tuple[float, float]
    wave: Wave

    @classmethod
    def of(cls, stripes: FinestStripes, plane: Ints, size: tuple[int, int], wave: Wave) -> "Beat | None":
        """Contrasts without smooth variation over each plane, and without outliers; None for too few pixels."""
        half, middle = (size[0] - 1) / 2, (np.array(size) - 1) / 2
        points = (stripes.projector_px - middle) / half
        fit, chosen = None, plane >= 0
        for _ in range(_ROUNDS):
            smooth, chosen = smooth_over(plane, points, chosen)
            if np.count_nonzero(chosen) < max(_FEWEST, 2 * smooth.shape[1]):
                return None
            data = stripes.log_ratio[chosen]
            data = data - smooth @ (smooth.T @ data)
            fit = cls(points[chosen], data, smooth, size, stripes.periods, wave)
            chosen[np.flatnonzero(chosen)[np.abs(data) > _OUTLIER_SIGMAS * robust_sigma(data)]] = False
        return fit

    @property
    def half(self) -> float:
        """Half the picture's width, in pixels."""
        return (self.size[0] - 1) / 2

    @property
    def tall(self) -> float:
        """The picture's height as a part of its width."""
        return self.size[1] / self.size[0]

    @property
    def alike(self) -> float:
        """Number of pixels per independent residual."""
        return max(_ALIKE, len(self.data) / _MOST_INDEPENDENT)

    def within(self, share: float) -> "Beat":
        """The pixels in the middle of the picture, up to this share of its width and height."""
        inside = np.all(np.abs(self.points) < (share, share * self.tall), axis=1)
        if inside.all():
            return self
        smooth = orthonormal(self.smooth[inside])
        data = self.data[inside]
        return replace(self, points=self.points[inside], data=data - smooth @ (smooth.T @ data), smooth=smooth)

    def leans(self, fit: BeatFit) -> bool:
        """Whether the far edge is narrower than the near one, by what matters and is certain."""
        lean, sigma = np.abs(fit.values[LEANS]), np.sqrt(np.diag(fit.covariance)[LEANS])
        axis = int(np.argmax(lean))
        at_corners_px = lean[axis] * self.half * (1.0, self.tall)[axis]
        return bool(at_corners_px > _LEAST_PX and lean[axis] > _SIGNIFICANT_SIGMAS * sigma[axis])

    def waves(self, values: Floats) -> Floats:
        """(2, N): the beats of x and of y, without what passes for smooth change."""
        x, y = self.half * (mapped(homography_of(values), self.points) - self.points).T
        both = np.stack([self.wave(x, self.periods[0]), -self.wave(y, self.periods[1])])
        return both - (both @ self.smooth) @ self.smooth.T

    def refined(self, start: Floats, free: tuple[int, ...]) -> BeatFit:
        """Refine a nearly correct start, by least squares."""
        columns = list(free)

        def values(step: Floats) -> Floats:
            moved = start.copy()
            moved[columns] += step[:-1] / self.half
            return moved

        def misfit(step: Floats) -> Floats:
            residuals: Floats = step[-1] * self.waves(values(step)).sum(axis=0) - self.data
            return residuals

        fit = scipy.optimize.least_squares(
            misfit, np.append(np.zeros(len(columns)), 1.0), method="lm", ftol=_PRECISE, xtol=_PRECISE
        )
        best = values(fit.x)
        strengths = np.linalg.lstsq(self.waves(best).T, self.data, rcond=None)[0]
        jacobian = np.asarray(fit.jac)
        inner = np.linalg.pinv(jacobian.T @ jacobian) * np.mean(fit.fun**2) * self.alike
        covariance = np.zeros((NUMBERS, NUMBERS))
        covariance[np.ix_(columns, columns)] = inner[:-1, :-1] / self.half**2
        explained = 1 - float(np.mean(fit.fun**2) / np.mean(self.data**2))
        return BeatFit(best, covariance, free, explained, (float(strengths[0]), float(strengths[1])))

    def without(self, fit: BeatFit) -> "Beat":
        """What is left when that is explained."""
        return replace(self, data=self.data - fit.strengths @ self.waves(fit.values))

    def believable(self, freer: BeatFit, fit: BeatFit) -> BeatFit:
        """The freer of two fits where it explains more than chance would, else the other."""
        gained = (freer.explained - fit.explained) / (1 - freer.explained) * len(self.data) / self.alike
        return freer if gained > _WORTH_THE_REST else fit
