"""Starts for a fit of beating contrasts: keystones are tried, the rest comes from the peak of a spectrum.

Keystone turns the beat into a chirp. With the right keystone undone, each axis has a single frequency, which a Fourier
transform finds.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import scipy

from calib.geometry import mapped
from calib.numerics import Floats, in_parallel
from scanner.decoding import Floats32
from scanner.reconstruction.keystone.beat import EVERYTHING, LEANS, UPRIGHT, Beat, homography_of

# Largest keystone that is searched for; more leaves no fine stripes.
_MOST_NARROWER = 0.05
_STEP_PX = 0.5  # at the corners of the picture
_CELLS_ALONG = 213
_LEAST_CELL_PX = 4.0
_PADDED = 1.3
_TRIED, _APART_PX = 8, 0.4
_BESIDE = 4
# Limits on the part of a spectrum that no beat explains, relative to noise; the second also holds with a keystone that
# is not undone, or there is none.
_LEAST_POWER, _LEAST_CHIRP = 50.0, 40.0
# Number of keystones tried to each side along both axes, in the middle part of the picture that they span.
_LEANS = 10
_TRIED_TWICE = 4
_GROWTH = 1.4


@dataclass(frozen=True)
class Start:
    """`values` of a homography, as in `beat.py`; `free`: which of them are not zero; and its `power`."""

    power: float
    values: Floats
    free: tuple[int, ...]


def starts(beat: Beat, spectrum: "Spectrum") -> Iterator[Start]:
    """The likeliest first of those that lean along one axis, or none; nothing where nothing beats."""
    if spectrum.beats:
        yield from _apart([*spectrum.about_one_axis, *spectrum.half_steps()], beat, _TRIED)


def starts_about_both_axes(beat: Beat, spectrum: "Spectrum") -> Iterator[Start]:
    """Those that lean along both axes: found in the middle, and followed as more of the picture is taken."""
    if spectrum.strongest < _LEAST_CHIRP:
        return
    share = min(1.0, float(np.sqrt(_LEANS / len(spectrum.about_one_axis))))
    middle = beat.within(share)
    step = _STEP_PX / (beat.half * share**2)
    leans = step * np.arange(-_LEANS, _LEANS + 1)
    peaks = Spectrum.of(middle).peaks(product(leans[leans > 0], leans[leans != 0]))
    for start in _apart(peaks, middle, _TRIED_TWICE):
        values, reached = start.values, share
        while reached < 1:
            values = beat.within(reached).refined(values, EVERYTHING).values
            reached *= _GROWTH
        yield replace(start, values=values)


def _apart(starts: Sequence[Start], beat: Beat, most: int) -> Iterator[Start]:
    """The strongest starts that differ at the picture's corners; of two opposite ones, with equal beats, the smaller
    one.
    """
    corners = np.array([(x, y) for x in (-1, 1) for y in (-1, 1)]) * (1.0, beat.tall)
    taken: list[Floats] = []
    for start in sorted(starts, key=lambda start: -start.power):
        moved = mapped(homography_of(start.values), corners) - corners
        if all(np.abs(moved - start).max() * beat.half > _APART_PX for start in taken):
            taken.append(moved)
            yield start if np.sum(moved * corners) < 0 else replace(start, values=-start.values)
        if len(taken) == most:
            return


@dataclass(frozen=True)
class Spectrum:
    """The data of a beat summed in the cells (rows, columns) of a grid, at `x` (1, columns) and `y` (rows, 1). Lengths
    are in units of `half` the picture's width in pixels, which is `tall` times as high; `energy`: of the data.
    """

    sums: Floats32
    x: Floats
    y: Floats
    cell: float
    half: float
    tall: float
    energy: float

    @property
    def beats(self) -> bool:
        """Whether there is anything to be explained."""
        return self.strongest >= _LEAST_POWER

    @property
    def strongest(self) -> float:
        """The most power with a lean along one axis."""
        return max(start.power for start in self.about_one_axis)

    @cached_property
    def about_one_axis(self) -> list[Start]:
        """Along x or along y, from not at all to the most, by steps that matter at the corners."""
        along_x, along_y = self._steps
        many_x, many_y = (int(np.ceil(_MOST_NARROWER / (2 * step))) for step in (along_x, along_y * self.tall))
        upwards = [(0.0, number * along_y) for number in range(many_y + 1)]
        return self.peaks([*upwards, *((number * along_x, 0.0) for number in range(1, many_x + 1))])

    @property
    def _steps(self) -> tuple[float, float]:
        """Of leans along x and y."""
        return _STEP_PX / self.half, _STEP_PX / (self.half * self.tall)

    def half_steps(self) -> list[Start]:
        """Starts half a step beside the strongest along one axis: a fit from whole steps may miss the minimum."""
        strongest = sorted(self.about_one_axis, key=lambda start: -start.power)[:_BESIDE]
        leans = {
            (x + by * self._steps[0] / 2, 0.0) if x else (0.0, y + by * self._steps[1] / 2)
            for x, y in (start.values[LEANS] for start in strongest)
            for by in (-1, 1)
        }
        return self.peaks(sorted(leans))

    @classmethod
    def of(cls, beat: Beat) -> "Spectrum":
        """Of cells that are fine enough for any keystone that is looked for."""
        width, height = beat.size
        cell = max(_LEAST_CELL_PX, width / _CELLS_ALONG)
        columns, rows = int(width / cell) + 2, int(height / cell) + 2
        at = beat.points.T
        column = ((at[0] * beat.half + width / 2) / cell).astype(np.int64).clip(0, columns - 1)
        row = ((at[1] * beat.half + height / 2) / cell).astype(np.int64).clip(0, rows - 1)
        sums = np.bincount(row * columns + column, beat.data, minlength=rows * columns).astype(np.float32)
        sums = sums.reshape(rows, columns)
        x: Floats = (((np.arange(columns) + 0.5) * cell - width / 2) / beat.half)[None, :].astype(np.float64)
        y: Floats = (((np.arange(rows) + 0.5) * cell - height / 2) / beat.half)[:, None].astype(np.float64)
        # The middle of a picture costs less to transform.
        at_x, at_y = (slice(of.min(), of.max() + 1) for of in (column, row))
        return cls(
            sums[at_y, at_x],
            x[:, at_x],
            y[at_y],
            cell / beat.half,
            beat.half,
            beat.tall,
            float(np.sum(beat.data**2)),
        )

    def peaks(self, leans: Iterable[tuple[float, float]]) -> list[Start]:
        """For each lean to the side and up, the likeliest homography."""
        return in_parallel(lambda lean: self._peak(*lean), leans)

    def _peak(self, lean_x: float, lean_y: float) -> Start:
        # Along a single axis, the transform is a row or a column.
        leans = [by * along for by, along in ((lean_x, self.x), (lean_y, self.y)) if by]
        lean = sum(leans, np.zeros((1, 1)))
        (power_x, xx, xy, x1), (power_y, yx, yy, y1) = (self._strongest(lean * along) for along in (self.x, self.y))
        power = (power_x + power_y) / self.energy
        # Beats along y lower the ratio.
        x1, y1 = (cycles - round(cycles) for cycles in (x1, y1 + 0.5))
        values = np.array([xx, xy, x1, yx, yy, y1, lean_x * self.half, lean_y * self.half]) / self.half
        if lean_x and lean_y:
            return Start(power, values, EVERYTHING)
        values[[1, 3]] = 0.0
        return Start(power, values, (*UPRIGHT, 6 if lean_x else 7))

    def _strongest(self, chirp: Floats) -> tuple[float, float, float, float]:
        """The power of the strongest wave, its frequencies along x and y, and its phase in the middle in cycles."""
        padded = tuple(scipy.fft.next_fast_len(int(_PADDED * count)) for count in self.sums.shape)
        angle = (2 * np.pi * self.half * chirp).astype(np.float32)
        turned = np.empty(self.sums.shape, np.complex64)
        np.multiply(self.sums, np.cos(angle), out=turned.real)
        np.multiply(self.sums, np.sin(angle), out=turned.imag)
        wave = scipy.fft.fft2(turned, s=padded)
        row, column = np.unravel_index(int(np.argmax(wave.real**2 + wave.imag**2)), padded)
        frequencies = [scipy.fft.fftfreq(count, self.cell) for count in padded]
        by_y, by_x = float(frequencies[0][row]), float(frequencies[1][column])
        strongest = complex(wave[row, column])
        phase = np.angle(strongest) / (2 * np.pi) - by_x * self.x[0, 0] - by_y * self.y[0, 0]
        return abs(strongest) ** 2, by_x, by_y, float(phase)
