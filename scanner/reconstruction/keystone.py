"""Keystone correction, measured: the homography by which the projector reshapes its picture, from what it spoils.

Where a pixel of the picture falls between two pixels of the panel, the finest stripes lose contrast; where it falls on
one, they keep it. Along both axes the loss beats with the shift between picture and panel, whole shifts being the
crests. The shift is that of a homography, so that a fit over the picture finds it to a small part of a pixel, up to its
sign, for the beats of a shift and of its opposite are the same: a projector only makes pictures smaller.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft, optimize

from calib.geometry import Matches, mapped
from calib.numerics import Bools, Floats, Ints, in_parallel, robust_sigma
from calib.refinement import Shift, monomials
from scanner.decoding import FinestStripes, first_harmonic, left_between

# How much narrower the far edge may be, for which is looked; more of it leaves no fine stripes.
_MOST_NARROWER = 0.05
_STEP_PX = 0.4  # at the picture's corners
_CELLS_ALONG = 213
_LEAST_CELL_PX = 4.0
_PADDED = 1.5
_TRIED, _APART_PX = 8, 0.4
_FEWEST = 300
_FEWEST_ON_A_PLANE = 100
_NEAR_PX = 2
_SECOND_ORDER = 6
_OUTLIER_SIGMAS, _ROUNDS = 3.5, 4
# Wider stripes lose less than 2 %.
_LONGEST_PX = 16.0
# What no beat explains of a spectrum, relative to noise, stays below it.
_LEAST_POWER = 50.0
# Of the amplitude that a linear interpolation between two pixels has, beats have 0.9 to 1.2; what else varies over real
# scenes has up to 0.6, and in simulated ones explains up to 2 % of the variance, where beats explain 9 % or more.
_LEAST_EXPLAINED, _LEAST_STRENGTH, _MOST_STRENGTH = 0.04, 0.75, 1.5
_SIGNIFICANT_SIGMAS, _LEAST_PX = 6.0, 0.5
# By how much the misfit must fall, in squared sigmas, to believe that a picture is turned, sheared, or leans twice.
_WORTH_THE_REST = 25.0
# The residuals of a scene are alike over several pixels of the sample.
_ALIKE = 4.0
# A homography, in units of half the picture's width about its middle, less the identity: what it adds to x by x, y and
# 1, to y by x, y and 1, to the denominator by x and y.
_UPRIGHT = (0, 2, 4, 5)  # what neither turns nor shears


@dataclass(frozen=True)
class Keystone:
    """`homography` (3, 3) takes the picture's pixels to the panel's, whole pixels of whose origin nobody can tell.

    `narrower`: how much smaller the far edge is shown than the near one, as a share. `shifts`: by what panel pixels may
    err, by fields of one standard deviation.
    """

    homography: Floats
    narrower: float
    shifts: tuple[Shift, ...]


def measure_keystone(stripes: FinestStripes, matches: Matches, plane: Ints, size: tuple[int, int]) -> Keystone | None:
    """What the projector of (width, height) pixels does to its picture, if it shows.

    `plane` (N,): which one each match is on, negative where it is on none. Over each plane contrast changes smoothly.
    """
    if max(stripes.periods) > _LONGEST_PX:
        return None
    where = _planes_at(stripes.camera_px, matches.camera_px, plane)
    if np.count_nonzero(where >= 0) < _FEWEST:
        return None
    beat = _Beat.of(stripes, where, size)
    if beat is None:
        return None
    fits = [beat.refined(start, free) for free, start in _starts(beat)]
    if not fits:
        return None
    # The wave has a cusp at each crest, by which it is found well, but only from nearby.
    beat = replace(beat, wave=left_between)
    best = max(fits, key=lambda fit: fit.explained)
    fit = beat.freed(beat.refined(best.values, best.free))
    return beat.keystone(fit) if fit.is_of_a_beat and beat.leans(fit) else None


@dataclass(frozen=True)
class _Fit:
    """`values` (8,) and their `covariance` (8, 8), of which some were `free`; the share of the variance that is
    `explained`, and by beats along x, y of what `strengths` relative to those that a linear interpolation has.
    """

    values: Floats
    covariance: Floats
    free: tuple[int, ...]
    explained: float
    strengths: tuple[float, float]

    @property
    def is_of_a_beat(self) -> bool:
        """Whether it is as strong along both axes as one is."""
        is_as_strong = all(_LEAST_STRENGTH <= strength <= _MOST_STRENGTH for strength in self.strengths)
        return is_as_strong and self.explained >= _LEAST_EXPLAINED


@dataclass(frozen=True)
class _Beat:
    """The logarithms `data` (N,) of contrasts at `x`, `y` (N,), in units of `half` the picture's width about its
    middle, without what is in `smooth` (N, M), whose columns are orthonormal. `wave`: how shifts in pixels and the
    period of stripes make them beat.
    """

    x: Floats
    y: Floats
    data: Floats
    smooth: Floats
    size: tuple[int, int]
    periods: tuple[float, float]
    wave: Callable[[Floats, float], Floats]

    @classmethod
    def of(cls, stripes: FinestStripes, plane: Ints, size: tuple[int, int]) -> "_Beat | None":
        """Without what changes smoothly over each plane, and without outliers."""
        half, middle = (size[0] - 1) / 2, (np.array(size) - 1) / 2
        x, y = ((stripes.projector_px - middle) / half).T
        found, chosen = None, plane >= 0
        for _ in range(_ROUNDS):
            smooth, chosen = _smooth_over(plane, x, y, chosen)
            if np.count_nonzero(chosen) < max(_FEWEST, 2 * smooth.shape[1]):
                return None
            data = stripes.log_ratio[chosen]
            data = data - smooth @ (smooth.T @ data)
            found = cls(x[chosen], y[chosen], data, smooth, size, stripes.periods, first_harmonic)
            chosen[np.flatnonzero(chosen)[np.abs(data) > _OUTLIER_SIGMAS * robust_sigma(data)]] = False
        return found

    @property
    def half(self) -> float:
        """Half the picture's width, in pixels."""
        return (self.size[0] - 1) / 2

    def leans(self, fit: _Fit) -> bool:
        """Whether the far edge is narrower than the near one, by what matters and is certain."""
        lean, sigma = np.abs(fit.values[6:]), np.sqrt(np.diag(fit.covariance)[6:])
        axis = int(np.argmax(lean))
        at_corners_px = lean[axis] * self.half * (1.0, self.size[1] / self.size[0])[axis]
        return bool(at_corners_px > _LEAST_PX and lean[axis] > _SIGNIFICANT_SIGMAS * sigma[axis])

    def shifts_px(self, values: Floats) -> tuple[Floats, Floats]:
        """Of panel against picture, (N,) along x and y."""
        xx, xy, x1, yx, yy, y1, lean_x, lean_y = values
        by = self.half / (1 + lean_x * self.x + lean_y * self.y)
        there_x = ((1 + xx) * self.x + xy * self.y + x1) * by
        there_y = (yx * self.x + (1 + yy) * self.y + y1) * by
        return there_x - self.half * self.x, there_y - self.half * self.y

    def waves(self, values: Floats) -> Floats:
        """(2, N): the beats of x and of y, without what passes for smooth change."""
        x, y = self.shifts_px(values)
        both = np.stack([self.wave(x, self.periods[0]), -self.wave(y, self.periods[1])])
        waves: Floats = both - (both @ self.smooth) @ self.smooth.T
        return waves

    def refined(self, start: Floats, free: tuple[int, ...]) -> _Fit:
        """By least squares, from what is nearly right."""
        columns = list(free)

        def values(step: Floats) -> Floats:
            moved = start.copy()
            moved[columns] += step[:-1] / self.half
            return moved

        def misfit(step: Floats) -> Floats:
            residuals: Floats = step[-1] * self.waves(values(step)).sum(axis=0) - self.data
            return residuals

        found = optimize.least_squares(misfit, np.append(np.zeros(len(columns)), 1.0), method="lm", max_nfev=300)
        best = values(found.x)
        strengths = np.linalg.lstsq(self.waves(best).T, self.data, rcond=None)[0]
        jacobian = np.asarray(found.jac)
        inner = np.linalg.pinv(jacobian.T @ jacobian) * np.mean(found.fun**2) * _ALIKE
        covariance = np.zeros((len(start), len(start)))
        covariance[np.ix_(columns, columns)] = inner[:-1, :-1] / self.half**2
        explained = 1 - float(np.mean(found.fun**2) / np.mean(self.data**2))
        return _Fit(best, covariance, free, explained, (float(strengths[0]), float(strengths[1])))

    def freed(self, fit: _Fit) -> _Fit:
        """With all of a homography free, where that explains more than chance would."""
        freed = self.refined(fit.values, tuple(range(len(fit.values))))
        gained = (freed.explained - fit.explained) / (1 - freed.explained) * len(self.data) / _ALIKE
        return freed if gained > _WORTH_THE_REST else fit

    def keystone(self, fit: _Fit) -> Keystone:
        """The homography between pixels, and the fields of its standard deviations."""
        homography = self._between_pixels(fit.values)
        eigenvalues, directions = np.linalg.eigh(fit.covariance)
        steps = [np.sqrt(value) * way for value, way in zip(eigenvalues, directions.T, strict=True) if value > 0]
        back = np.linalg.inv(homography)

        def shifted(step: Floats) -> Shift:
            other = self._between_pixels(fit.values + step) @ back

            def shift(_camera_px: Floats, projector_px: Floats, _gradient: Floats) -> Floats:
                moved: Floats = mapped(other, projector_px) - projector_px
                return moved

            return shift

        leans = 2 * np.abs(fit.values[6:]) * (1.0, self.size[1] / self.size[0])
        return Keystone(homography, float(leans.max()), tuple(map(shifted, steps)))

    def _between_pixels(self, values: Floats) -> Floats:
        xx, xy, x1, yx, yy, y1, lean_x, lean_y = values
        to_units = np.array([[1, 0, -self.half], [0, 1, -(self.size[1] - 1) / 2], [0, 0, self.half]]) / self.half
        within = np.array([[1 + xx, xy, x1], [yx, 1 + yy, y1], [lean_x, lean_y, 1]])
        homography: Floats = np.linalg.inv(to_units) @ within @ to_units
        return homography


def _starts(beat: _Beat) -> Iterator[tuple[tuple[int, ...], Floats]]:
    """Homographies that are nearly right, the likeliest first, each with those of its numbers that are not zero. None
    where nothing beats.

    A lean multiplies waves by a chirp; without that each axis has one frequency left, which a Fourier transform finds.
    """
    width, height = beat.size
    cell = max(_LEAST_CELL_PX, width / _CELLS_ALONG)
    columns, rows = int(width / cell) + 2, int(height / cell) + 2
    column = ((beat.x * beat.half + width / 2) / cell).astype(np.int64).clip(0, columns - 1)
    row = ((beat.y * beat.half + height / 2) / cell).astype(np.int64).clip(0, rows - 1)
    sums = np.bincount(row * columns + column, beat.data, minlength=rows * columns).reshape(rows, columns)
    at_x = (((np.arange(columns) + 0.5) * cell - width / 2) / beat.half)[None, :]
    at_y = (((np.arange(rows) + 0.5) * cell - height / 2) / beat.half)[:, None]
    padded = fft.next_fast_len(int(_PADDED * rows)), fft.next_fast_len(int(_PADDED * columns))
    frequencies = [fft.fftfreq(size, cell / beat.half) for size in padded]
    first = np.array([at_y[0, 0], at_x[0, 0]])

    def peak(chirp: Floats) -> tuple[float, float, float, float]:
        turned = (sums * np.exp(2j * np.pi * beat.half * chirp)).astype(np.complex64)
        spectrum = fft.fft2(turned, s=padded)
        power = np.abs(spectrum)
        at = np.unravel_index(int(np.argmax(power)), padded)
        by_y, by_x = (float(of[i]) for of, i in zip(frequencies, at, strict=True))
        cycles = float(np.angle(spectrum[at])) / (2 * np.pi) - by_y * first[0] - by_x * first[1]
        return float(power[at]) ** 2, by_x, by_y, cycles

    found = []
    for lean_at, (of_x, of_y), furthest in (
        (7, (at_x * at_y, at_y * at_y), height / width),
        (6, (at_x * at_x, at_x * at_y), 1.0),
    ):
        step = _STEP_PX / (beat.half * furthest)
        for number in range(int(np.ceil(_MOST_NARROWER / (2 * furthest * step))) + 1):
            lean = number * step
            (power_x, xx, _, x1), (power_y, _, yy, y1) = in_parallel(peak, [lean * of_x, lean * of_y])
            # Beats along y lower the ratio.
            cycles = [each - round(each) for each in (x1, y1 + 0.5)]
            values = np.array([xx, 0.0, cycles[0], 0.0, yy, cycles[1], 0.0, 0.0]) / beat.half
            values[lean_at] = lean
            found.append((power_x + power_y, lean_at, values))
    found.sort(key=lambda each: -each[0])
    tried: list[Floats] = []
    if found[0][0] < _LEAST_POWER * float(np.sum(beat.data**2)):
        return
    for _, lean_at, values in found:
        there = _at_corners(values, height / width)
        if all(np.abs(there - other).max() * beat.half > _APART_PX for other in tried):
            tried.append(there)
            yield (*_UPRIGHT, lean_at), values if _shrinks(there, height / width) else -values
        if len(tried) == _TRIED:
            return


def _corners(tall: float) -> Floats:
    """Of a picture that is so tall as a part of its width, (4, 2)."""
    return np.array([(x, y) for x in (-1, 1) for y in (-tall, tall)])


def _at_corners(values: Floats, tall: float) -> Floats:
    """By how much the corners of the picture move, (4, 2)."""
    corners = _corners(tall)
    there = corners * (1 + values[[0, 4]]) + values[[2, 5]]
    moved: Floats = there / (1 + corners @ values[6:])[:, None] - corners
    return moved


def _shrinks(moved: Floats, tall: float) -> bool:
    """Whether the corners of the picture move inwards, on the whole."""
    return float(np.sum(moved * _corners(tall))) < 0


def _planes_at(pixels: Floats, camera_px: Floats, plane: Ints) -> Ints:
    """Which plane camera pixels (P, 2) are on, as all matches near them say; −1 where none does, or they differ."""
    column, row = np.rint(camera_px).astype(np.int64).T
    at, down = pixels.astype(np.int64).T
    width, height = max(column.max(), at.max()) + 1, max(row.max(), down.max()) + 1
    nobody = np.int32(np.iinfo(np.int32).max)
    labels = np.full((height + 2 * _NEAR_PX, width + 2 * _NEAR_PX), nobody, np.int32)
    labels[row + _NEAR_PX, column + _NEAR_PX] = plane
    near = np.stack([labels[down + i, at + j] for i in range(2 * _NEAR_PX + 1) for j in range(2 * _NEAR_PX + 1)])
    least = near.min(axis=0)
    greatest = np.where(near == nobody, np.int32(-1), near).max(axis=0)
    return np.where(least == greatest, least, -1)


def _smooth_over(plane: Ints, x: Floats, y: Floats, chosen: Bools) -> tuple[Floats, Bools]:
    """An orthonormal basis (N, M) of what changes up to second order over each plane, for the chosen pixels that are on
    one of some size.
    """
    large = [number for number in np.unique(plane[chosen]) if np.sum(chosen & (plane == number)) >= _FEWEST_ON_A_PLANE]
    chosen = chosen & np.isin(plane, large)
    here, where = np.stack([x, y], axis=1)[chosen], plane[chosen]
    columns = np.zeros((len(here), _SECOND_ORDER * len(large)))
    for number, label in enumerate(large):
        on = where == label
        columns[on, _SECOND_ORDER * number : _SECOND_ORDER * (number + 1)] = monomials(here[on])[:, :_SECOND_ORDER]
    return np.linalg.qr(columns)[0], chosen
