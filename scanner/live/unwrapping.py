"""Frames of one round → coordinates, variances and reasons, in one compiled pass; and isolated pixels.

Four tests decide about a pixel: its fringes exceed its noise, both have the same mean, the shorter one fits the longer
one, and its brightness equals that of the round before.
"""

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image, compiled
from scanner.decoding import MaskReason, in_nearest_cycle

Map = NDArray[np.float32]
Reasons = NDArray[np.uint8]

_KEPT, _DARK, _SATURATED = int(MaskReason.KEPT), int(MaskReason.DARK), int(MaskReason.SATURATED)
_INCONSISTENT, _OUTSIDE, _MOVED = int(MaskReason.INCONSISTENT), int(MaskReason.OUTSIDE), int(MaskReason.MOVED)
_ISOLATED = int(MaskReason.ISOLATED)

_STEPS = 3
LEAST_SIGNAL = 5.0  # amplitude over noise
_ORDER_SIGMAS = 4.0  # half a short period over the sigma of the long fringe: one pixel in 15,000 slips a period
BEYOND_SIGMAS = 4.5
_UNEVEN = 0.03  # share of an amplitude: difference of the means left by an imperfectly corrected response
UNSTRAIGHT = 0.004  # share of a long period: the same, and interreflection
_FLICKER = 0.007  # share of a level
# Limit on χ² of six frames compared with the round before: one static pixel in 10,000 exceeds it.
# The same for five frames and one pixel in 100: motion changes most frames, a late frame is a single one.
_MOVED_CHI2, _STILL_CHI2 = 28.0, 15.0
# Frames at times −2, 0 and 2: motion by δ between frames shifts the phase by up to 2/√3 δ.
_SWAY_PER_FRAME = 1.1547
_MOST_SWAY = 0.08  # share of a short period
# If the mean changes by d in a round of six frames, it changes by d/6 per frame, and shifts a phase by this times d
# over the amplitude (rms).
_SHIFT_BY_BRIGHTNESS = 0.22


@compiled
def unwrap(
    frames: Image,
    before: Image,
    coordinate_before: Map,
    rounds_apart: float,
    middle: Map,
    periods: tuple[float, float],
    length: float,
    noise: tuple[float, float],
    saturated: float,
    coordinate: Map,
    variance: Map,
    reason: Reasons,
    moving: Reasons,
) -> None:
    """Fill in `coordinate` (H, W), NaN for none, its `variance`, the `reason` for a mask, and whether it is `moving`.

    `frames` (6, H, W): long and short fringes alternate. `before` and `coordinate_before` are of the round
    `rounds_apart` earlier; 0: there is none.

    With I_n = m + a cos(θ + 2πn/3), n = 0, 1, 2: a cos θ = ⅔ Σ I_n cos(2πn/3), a sin θ = −⅔ Σ I_n sin(2πn/3) (Creath
    1988), and the variance of θ is ⅔ σ²/a².
    """
    long_px, short_px = periods
    at_black, gain = noise
    turn = 2.0 * np.pi
    third = 1.0 / np.sqrt(3.0)
    for row in range(frames.shape[1]):
        for column in range(frames.shape[2]):
            l0, s0 = np.float32(frames[0, row, column]), np.float32(frames[1, row, column])
            l1, s1 = np.float32(frames[2, row, column]), np.float32(frames[3, row, column])
            l2, s2 = np.float32(frames[4, row, column]), np.float32(frames[5, row, column])
            coordinate[row, column], variance[row, column], moving[row, column] = np.nan, np.nan, 0
            if max(max(max(l0, l1), l2), max(max(s0, s1), s2)) >= saturated:
                reason[row, column] = _SATURATED
                continue
            long_mean, short_mean = (l0 + l1 + l2) / 3.0, (s0 + s1 + s2) / 3.0
            long_cosine, long_sine = (2.0 * l0 - l1 - l2) / 3.0, (l2 - l1) * third
            short_cosine, short_sine = (2.0 * s0 - s1 - s2) / 3.0, (s2 - s1) * third
            level = 0.5 * (long_mean + short_mean)
            of_pixel = at_black + gain * level
            long_square = long_cosine * long_cosine + long_sine * long_sine
            short_square = short_cosine * short_cosine + short_sine * short_sine
            of_phase = of_pixel / 1.5 / (turn * turn)
            long_variance = long_px * long_px * of_phase / long_square
            short_variance = short_px * short_px * of_phase / short_square
            if (
                short_square < LEAST_SIGNAL * LEAST_SIGNAL * of_pixel
                or 4.0 * _ORDER_SIGMAS * _ORDER_SIGMAS * long_variance > short_px * short_px
            ):
                reason[row, column] = _DARK
                continue

            drift, sway = np.float32(0.0), np.float32(0.0)
            if rounds_apart > 0.0:
                chi2, largest, mean_before = np.float32(0.0), np.float32(0.0), np.float32(0.0)
                for n in range(2 * _STEPS):
                    now, then = np.float32(frames[n, row, column]), np.float32(before[n, row, column])
                    spread = at_black + gain * now + _FLICKER * _FLICKER * now * now
                    term = (now - then) * (now - then) / (2.0 * spread)
                    chi2, largest = chi2 + term, max(largest, term)
                    mean_before += then / 6.0
                if chi2 > _MOVED_CHI2:
                    if chi2 - largest < _STILL_CHI2:
                        reason[row, column] = _INCONSISTENT
                        continue
                    moving[row, column] = 1
                    drift = (level - mean_before) / rounds_apart

            uneven = abs(long_mean - short_mean)
            allowed = BEYOND_SIGMAS * np.sqrt(2.0 / 3.0 * of_pixel) + _UNEVEN * np.sqrt(long_square)
            if uneven > allowed + abs(drift) / 3.0:
                reason[row, column] = _INCONSISTENT
                continue
            coarse = long_px * np.arctan2(long_sine, long_cosine) / turn
            coarse = in_nearest_cycle(coarse, middle[row, column], long_px)
            fine = short_px * np.arctan2(short_sine, short_cosine) / turn
            fine = in_nearest_cycle(fine, coarse, short_px)
            beyond = abs(fine - coarse)
            limit = BEYOND_SIGMAS * np.sqrt(long_variance + short_variance) + UNSTRAIGHT * long_px
            if moving[row, column] == 1:
                past = coordinate_before[row, column]
                sway = _SWAY_PER_FRAME * abs(fine - past) / (6.0 * rounds_apart)
                if not sway < _MOST_SWAY * short_px:  # also for NaN
                    reason[row, column] = _MOVED
                    continue
                limit += sway
            if beyond > limit:
                reason[row, column] = _INCONSISTENT
                continue
            if not (fine >= -0.5 and fine <= length - 0.5):
                reason[row, column] = _OUTSIDE
                continue
            by_brightness = _SHIFT_BY_BRIGHTNESS * drift * short_px / turn / np.sqrt(short_square)
            reason[row, column] = _KEPT
            coordinate[row, column] = fine
            variance[row, column] = short_variance + 0.5 * sway * sway + by_brightness * by_brightness


@compiled
def leave_out_isolated(coordinate: Map, variance: Map, step_px: float, reason: Reasons, first: int, last: int) -> None:
    """Mask isolated pixels of the rows `first` to `last`, in `reason` (H, W) only.

    If fewer than three of its eight neighbours continue within `step_px` and noise, a pixel is at an edge, where it
    sees two surfaces, or isolated.
    """
    height, width = coordinate.shape
    for row in range(first, last):
        for column in range(width):
            if reason[row, column] != _KEPT:
                continue
            near = 0
            for up in range(max(0, row - 1), min(height, row + 2)):
                for left in range(max(0, column - 1), min(width, column + 2)):
                    apart = coordinate[up, left] - coordinate[row, column]
                    limit = step_px + BEYOND_SIGMAS * np.sqrt(variance[up, left] + variance[row, column])
                    near += abs(apart) <= limit  # false for NaN
            if near < 4:  # including itself
                reason[row, column] = _ISOLATED
