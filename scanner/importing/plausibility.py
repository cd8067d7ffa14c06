"""Do the frames make sense in an order? A first look at few pixels, so that many orders can be tried.

Wrong orders decode to numbers like any others. But in the right one neighbours see neighbouring projector pixels, the
map from camera to projector is not mirrored, and all of it obeys one epipolar geometry.

Whether a Gray code along one axis is consistent in an order, without a second axis.

Adjacent cells of the projector are adjacent on a surface. In a wrong order, or with another code, adjacent pixels still
differ in one bit, but their cells are far apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.importing.coarse_coordinates import Coordinates, Mismatch, contrasts_of_bits, coordinates
from scanner.importing.samples import LevelSamples
from scanner.importing.unwrapping import PLACES_OF_CYCLE
from scanner.patterns import Axis, Black, Gray, Pattern, White

_FEWEST = 200
_AXES: tuple[Axis, ...] = ("x", "y")
_MOST_DARKER = 0.1
_FAINT = 0.8
# Random codes differ by a quarter of their range, neighbours on a surface by hundredths.
_MOST_APART = 0.1
_LEAST_UPRIGHT = 0.65
_LEAST_ON_LINES = 0.6
_MOST_FITTED = 3000
_NEAR = 4.0  # of epipolar lines, in the units of the coordinates, which need not be pixels
_MOST_JUMPS = 0.2
_AS_CLOSE = 1.5
# Pixels at the edge of a stripe are undecided; this is the distance of the decided ones on either side.
_MOST_APART_PX = 8
_FEWEST_CHANGES = 30
# Tolerances in cells, or as shares of all cells: errors of the finest bits, and cells skipped by large pixels.
_NEAR_CELLS, _NEAR_SHARE = 4, 1 / 64


class OrderStage(IntEnum):
    """How far the frames got as some patterns."""

    COUNT = 0
    """There are as many frames."""
    LIGHT = 1
    """White is brighter than black."""
    SIGNALS = 2
    """Frames are bits or fringes."""
    NEIGHBOURS = 3
    """Neighbouring pixels have neighbouring coordinates."""
    GEOMETRY = 4
    """The coordinates of both axes belong together."""
    DECODING = 5
    """All frames decode."""
    MIRRORED = 6
    """They do so as taken, not only mirrored back."""
    OPTIONS = 7
    """They may decode once more is known."""
    SIZE = 8
    """They fit projectors of several sizes, or none."""


@dataclass(frozen=True)
class Objection:
    """Why frames cannot be some patterns."""

    stage: OrderStage
    """The stage that they did not pass."""
    words: str
    reached: float = 0.0
    """The share of the stage that they did pass."""
    flip: Axis | None = None
    """The axis along which they look mirrored."""


def objection(samples: LevelSamples, patterns: Sequence[Pattern]) -> Objection | None:
    """Why the frames cannot be these patterns; None if they may be."""
    if np.count_nonzero(samples.lit) < _FEWEST:
        return Objection(OrderStage.LIGHT, "the frames hardly differ")
    ends = {type(p): samples.levels[index] for index, p in enumerate(patterns) if isinstance(p, White | Black)}
    if White in ends and Black in ends:
        # An automatic exposure takes the contrast, but does not make black the brighter one.
        darker = float(np.mean((ends[White] <= ends[Black])[samples.lit]))
        if darker > _MOST_DARKER:
            return Objection(OrderStage.LIGHT, f"white is darker than black at {darker:.0%} of the pixels")
    by_axis: dict[Axis, Coordinates] = {}
    for axis in _AXES:
        measured = coordinates(samples, patterns, axis)
        if isinstance(measured, Mismatch):
            return Objection(OrderStage.SIGNALS, measured.words, len(by_axis) + measured.reached)
        if measured is not None:
            by_axis[axis] = measured
    # A mirrored capture with x before y looks like one with y before x and the camera on its side.
    may_be_turned = len(by_axis) > 1 and next(p.axis for p in patterns if not isinstance(p, White | Black)) == "x"
    may_be_turned &= not any(measured.misfit is not None for measured in by_axis.values())
    turned = None if may_be_turned else _along_the_other(by_axis)
    return _scattered(by_axis) or turned or (_nonsense(samples, by_axis) if len(by_axis) > 1 else None)


def faint_bits(samples: LevelSamples, patterns: Sequence[Pattern]) -> dict[Axis, int]:
    """How many of the finest bits of each axis have less contrast than the coarsest, so that they may be wrong."""
    contrasts = {axis: contrasts_of_bits(samples, patterns, axis) for axis in _AXES}
    return {
        axis: next(n for n, contrast in enumerate([*of_bits[::-1], 1.0]) if contrast >= _FAINT * max(of_bits))
        for axis, of_bits in contrasts.items()
        if of_bits
    }


def unresolved_bits(samples: LevelSamples, patterns: Sequence[Pattern]) -> dict[Axis, int]:
    """How many of the finest bits of each axis the camera does not resolve, in frames that may be these patterns."""
    by_axis = {axis: coordinates(samples, patterns, axis) for axis in _AXES}
    return {axis: code.unresolved for axis, code in by_axis.items() if isinstance(code, Coordinates)}


def best_fitting(samples: LevelSamples, orders: Sequence[Sequence[Pattern]]) -> list[int]:
    """The numbers of the orders that fit the frames best, if only fringes decide; others fit partly by chance."""
    misfits = []
    for patterns in orders if len(orders) > 1 else ():
        by_axis = [coordinates(samples, patterns, axis) for axis in _AXES]
        misfits.append(sum(measured.misfit or 0.0 for measured in by_axis if isinstance(measured, Coordinates)))
    return [number for number, misfit in enumerate(misfits) if misfit <= _AS_CLOSE * min(misfits)] if misfits else [0]


def _along_the_other(by_axis: dict[Axis, Coordinates]) -> Objection | None:
    """Devices stand roughly upright: x grows along the camera's rows, y along its columns."""
    for axis, measured in by_axis.items():
        farthest = _MOST_APART * _spread(measured)
        steps = [np.abs(after - before) for before, after in _adjacent(measured.values, measured.certain)]
        across, down = (float(np.mean(np.minimum(step, farthest))) if len(step) else 0.0 for step in steps)
        if (across < down) == (axis == "x"):
            return Objection(OrderStage.GEOMETRY, f"the stripes run the other way than those of {axis}")
        if measured.misfit is not None and _mean_step(measured, axis) < 0:
            return Objection(OrderStage.GEOMETRY, f"the fringes of {axis} run backwards")
    return None


def _mean_step(measured: Coordinates, axis: Axis) -> float:
    """How often a coordinate grows to the next pixel along an upright camera's rows or columns, or falls: −1 to 1."""
    before, after = _adjacent(measured.values, measured.certain)[_AXES.index(axis)]
    return float(np.mean(np.sign(after - before))) if len(before) else 0.0


def _scattered(by_axis: dict[Axis, Coordinates]) -> Objection | None:
    for axis, measured in by_axis.items():
        pairs = _adjacent(measured.values, measured.certain)
        steps = np.concatenate([np.abs(after - before) for before, after in pairs])
        if not len(steps) or np.median(steps) > max(_MOST_APART * _spread(measured), 1.0):
            return Objection(OrderStage.NEIGHBOURS, f"neighbouring pixels have unrelated codes in {axis}")
        if measured.misfit is not None and np.mean(steps > 2 * PLACES_OF_CYCLE * measured.steps) > _MOST_JUMPS:
            return Objection(OrderStage.NEIGHBOURS, f"the fringes of {axis} contradict each other: other --periods?")
    return None


def _spread(measured: Coordinates) -> float:
    return float(np.ptp(np.percentile(measured.values[measured.certain], (5, 95))))


def _nonsense(samples: LevelSamples, by_axis: dict[Axis, Coordinates]) -> Objection | None:
    x, y = by_axis["x"], by_axis["y"]
    both = x.certain & y.certain
    if np.count_nonzero(both) < _FEWEST:
        return Objection(OrderStage.SIGNALS, "too few pixels have both codes", 2.0)
    upright = _upright(x.values, y.values, both)
    if 1 - _LEAST_UPRIGHT < upright < _LEAST_UPRIGHT:
        return Objection(
            OrderStage.GEOMETRY,
            f"x and y belong to different codes: they are mirrored at {1 - upright:.0%} of the pixels",
        )
    projector_px = np.stack([x.values[both] / x.steps, y.values[both] / y.steps], axis=1)
    on_lines = share_on_epipolar_lines(samples.camera_px[both], projector_px)
    if on_lines < _LEAST_ON_LINES:
        return Objection(OrderStage.GEOMETRY, f"only {on_lines:.0%} of the pixels obey one epipolar geometry", on_lines)
    if upright >= _LEAST_UPRIGHT:
        return None
    if _along_the_other(by_axis):
        words = "the codes are mirrored, or x and y are exchanged"
        return Objection(OrderStage.GEOMETRY, words, on_lines)
    flip: Axis = "x" if _mean_step(x, "x") < 0 else "y"
    return Objection(
        OrderStage.MIRRORED,
        f"fits, but {flip} runs backwards, as in a mirror, at {1 - upright:.0%} of the pixels. If writing in them is "
        f"mirrored, the camera or its driver mirrors: give --flip {flip}. If it is not, the projector does, as for "
        "rear projection: switch that off and take the frames again, for flipped ones would show the room in a mirror",
        flip=flip,
    )


def _adjacent(numbers: Floats, there: Bools) -> list[tuple[Floats, Floats]]:
    """Values of horizontally and of vertically adjacent pixels."""
    right, below = there[:, :-1] & there[:, 1:], there[:-1] & there[1:]
    return [(numbers[:, :-1][right], numbers[:, 1:][right]), (numbers[:-1][below], numbers[1:][below])]


def _upright(x: Floats, y: Floats, there: Bools) -> float:
    """Share of the pixels where the map to the projector is not mirrored, of those where it is defined."""
    inner = there[:-1, :-1] & there[:-1, 1:] & there[1:, :-1]
    turn = np.diff(x, axis=1)[:-1] * np.diff(y, axis=0)[:, :-1] - np.diff(y, axis=1)[:-1] * np.diff(x, axis=0)[:, :-1]
    turning = turn[inner & (turn != 0)]
    return float(np.mean(turning > 0)) if len(turning) else 0.0


def share_on_epipolar_lines(camera_px: Floats, projector_px: Floats) -> float:
    """Share of matches (N, 2) near the epipolar lines of one fundamental matrix, without lens distortion."""
    chosen = np.random.default_rng(0).permutation(len(camera_px))[:_MOST_FITTED]
    cv2.setRNGSeed(0)
    _, near = cv2.findFundamentalMat(camera_px[chosen], projector_px[chosen], cv2.USAC_MAGSAC, _NEAR, 0.999, 2000)
    return 0.0 if near is None else float(np.mean(near > 0))


def broken_order(lines: LevelSamples, patterns: Sequence[Pattern], axis: Axis) -> str | None:
    """Return what contradicts patterns along one axis, tested on rows or columns across the stripes; None if nothing
    does.

    Fringes alone cannot be tested.
    """
    bits = max((p.bits for p in patterns if isinstance(p, Gray) and p.axis == axis), default=0)
    if not bits:
        return None
    code = coordinates(lines, patterns, axis)
    if isinstance(code, Mismatch):
        return code.words
    if code is None:
        return None
    number, certain = ((part if axis == "x" else part.T) for part in (code.values.astype(np.int64), code.certain))
    place = np.flatnonzero(certain)
    row, column = np.divmod(place, certain.shape[1])
    beside = (np.diff(row) == 0) & (np.diff(column) <= _MOST_APART_PX)
    number = number.ravel()[place]
    word = number ^ number >> 1
    cells, changed = np.abs(np.diff(number))[beside], (word[1:] ^ word[:-1])[beside]
    near = max(_NEAR_CELLS, _NEAR_SHARE * (1 << bits))
    for bit in range(bits):
        of_bit = cells[changed >> bits - 1 - bit & 1 == 1]
        if len(of_bit) >= _FEWEST_CHANGES and np.median(of_bit) > near:
            apart = f"bit {bit} of {axis} are {np.median(of_bit):.0f} cells apart"
            return f"no Gray code in an order that is known: pixels beside each other that differ in {apart}"
    return None
