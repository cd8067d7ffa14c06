"""The camera's response curve, from sums of frames, and frames taken back to light.

A pattern and its inverse make the same light as every other pair. Blurred stripes make it of two middling levels, sharp
ones of a dark and a bright level, so that a tone curve, as of photographs, makes their sums differ. The curve f of
which g = f⁻¹ makes all sums alike, g(I) + g(I') = M at every pixel, is the camera's: least squares in the values of g
at a few levels (radiometric self-calibration, after Mitsunaga and Nayar, CVPR 1999). In the light g(I) all the rest
holds: what adds up, what is half-way, what is a cosine.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np

from calib.numerics import Floats, Image, median
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.brightness import lit_by
from scanner.decoding.medians import medians
from scanner.decoding.sequence_plan import SequencePlan

# g is linear between so many levels; how much its second differences weigh, and what is given, against the sums.
_LEVELS, _STIFFNESS, _HELD = 17, 1e-3, 10.0
_ROUNDS = 4
# Farther off the sums than so many times what most are counts less: something moves there, or flickers.
_OUTLYING = 4.5
_FEWEST_PAIRS, _FEWEST_PIXELS, _MOST_PIXELS = 3, 200, 1000
# The squares of what sums are off, in swings, added up over pairs: less is no matter. The right curve leaves a tenth of
# them; nothing else that bends sums leaves so little to a curve that rises everywhere, by this part of its mean slope.
_NOTABLE, _LEFT, _LEAST_SLOPE = 0.006, 0.2, 0.03
_RARE = 0.001  # levels that are hardly there say nothing of their slope
# The light is told in numbers of so many bits: 8 would be too few in the dark, where the curve is steep.
_FULL_SCALE = 4095


@dataclass(frozen=True)
class CameraResponse:
    """`light` (levels,): that of grey levels evenly spaced from 0 to `top`, in parts of that of the last one. From
    `saturation` on pixels are clipped.
    """

    light: Floats
    top: float
    saturation: float

    def linearised(self, frames: Image) -> Iterator[Image]:
        """Frames (N, H, W) as light, one by one, of 16 bits."""
        levels = np.arange(int(self.top) + 1)
        light = np.rint(_FULL_SCALE * np.interp(levels, np.linspace(0, self.top, len(self.light)), self.light))
        light[levels >= self.saturation] = _FULL_SCALE
        table = light.astype(np.uint16)
        return (cast(Image, table[frame]) for frame in frames)


def camera_response(plan: SequencePlan, levels: Floats32, saturation: float, top: float) -> CameraResponse | None:
    """That which a sample `levels` (frames, P) of all frames tells, up to a level `top`; None if sums are even without
    one, or one does not make them so.
    """
    lit = lit_by(np.ptp(levels, axis=0))
    lit = lit[levels[:, lit].max(axis=0) < saturation]
    if len(plan.complements) < _FEWEST_PAIRS or len(lit) < _FEWEST_PIXELS:
        return None
    seen = levels[:, lit[:: -(-len(lit) // _MOST_PIXELS)]] / np.float32(top)
    swing = _interpolation(seen.max(axis=0)) - _interpolation(seen.min(axis=0))
    first, second = np.array(plan.complements).T
    sums = _interpolation(seen)
    sums = sums[first] + sums[second]
    linear = np.linspace(0, 1, _LEVELS)
    before = _unevenness(sums @ linear, swing @ linear)
    if before < _NOTABLE:
        return None
    light = _levelling(sums - sums.mean(axis=0), swing)
    slopes = np.diff(light) / np.mean(np.diff(light))
    count, _ = np.histogram(seen, linear)
    is_rising = bool(np.all(slopes[count > _RARE * seen.size] > _LEAST_SLOPE))
    if not is_rising or _unevenness(sums @ light, swing @ light) > _LEFT * before:
        return None
    light = np.concatenate([[0.0], np.cumsum(np.maximum(slopes, _LEAST_SLOPE))])
    return CameraResponse(light / light[-1], top, saturation)


def _interpolation(levels: Floats32) -> Floats:
    """The weights (…, _LEVELS) with which the values of g make g(I), for I (…) from 0 to 1."""
    place = np.clip(levels, 0, 1) * (_LEVELS - 1)
    return np.maximum(0, 1 - np.abs(place[..., None] - np.arange(_LEVELS)))


def _levelling(off: Floats, swing: Floats) -> Floats:
    """The values (_LEVELS,) of g that make `off` @ g least, in swings; in the mean these are as they are without g.

    `off` (pairs, P, _LEVELS): sums of pairs less those of all; `swing` (P, _LEVELS): what makes the swings.
    """
    rows, mean = off.reshape(-1, _LEVELS), swing.mean(axis=0)
    bends = np.diff(np.eye(_LEVELS), 2, axis=0)
    light, weights = np.linspace(0, 1, _LEVELS), np.ones(len(rows))
    given, offset = np.outer(mean, mean), np.outer(np.eye(_LEVELS)[0], np.eye(_LEVELS)[0])
    as_it_is = mean * float(mean @ light)
    for _ in range(_ROUNDS):
        of_swing = swing @ light
        of_swing = np.maximum(of_swing, _LEAST_SLOPE * median(of_swing))
        relative = rows / np.tile(of_swing, len(off))[:, None]
        normal = relative.T @ (weights[:, None] * relative) / len(rows) + _STIFFNESS * bends.T @ bends
        light = np.linalg.solve(normal + _HELD * (given + offset), _HELD * as_it_is).astype(np.float64)
        away = np.abs(relative @ light)
        weights = 1 / (1 + (away / (_OUTLYING * median(away) + 1e-4)) ** 2)
    return light


def _unevenness(sums: Floats, swing: Floats) -> float:
    """How far sums (pairs, P) are from those of most pairs, squared, in swings (P,): of the median pixel, added up."""
    return float(np.sum(medians(((sums - medians(sums, axis=0)) / swing) ** 2, axis=1)))
