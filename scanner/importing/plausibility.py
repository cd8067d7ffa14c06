"""Do the frames make sense in an order? A first look at few pixels, so that many orders can be tried.

Wrong orders decode to numbers like any others. But in the right one neighbours see neighbouring projector pixels, the
map from camera to projector is not mirrored, and all of it obeys one epipolar geometry.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.importing.coarse_coordinates import Coordinates, coordinates
from scanner.importing.samples import LevelSamples
from scanner.importing.unwrapping import PLACES_OF_CYCLE
from scanner.patterns import Axis, Black, Pattern, White

_FEWEST = 200
_LEAST_CONTRAST = 0.5
# Random codes differ by a quarter of their range, neighbours on a surface by hundredths.
_MOST_APART = 0.1
_LEAST_UPRIGHT = 0.65
_LEAST_ON_LINES = 0.6
_MOST_FITTED = 3000
_NEAR = 4.0  # of epipolar lines, in the units of the coordinates, which need not be pixels
_MOST_JUMPS = 0.2
_AS_CLOSE = 1.5


class PlausibilityStage(IntEnum):
    """The stage that a quick look at the frames has reached."""

    LIGHT = 0
    SIGNALS = 1
    NEIGHBOURS = 2
    GEOMETRY = 3


@dataclass(frozen=True)
class Objection:
    """Why frames cannot be some patterns, in a few words."""

    stage: PlausibilityStage
    words: str


def objection(samples: LevelSamples, patterns: Sequence[Pattern]) -> Objection | None:
    """Why the frames cannot be these patterns; None if they may be."""
    if np.count_nonzero(samples.lit) < _FEWEST:
        return Objection(PlausibilityStage.LIGHT, "the frames hardly differ")
    known = {type(p): samples.levels[index] for index, p in enumerate(patterns) if isinstance(p, White | Black)}
    if White in known and Black in known:
        contrast = (known[White] - known[Black])[samples.lit] / samples.swing[samples.lit]
        if np.median(contrast) < _LEAST_CONTRAST:
            return Objection(PlausibilityStage.LIGHT, "the white frame is not brighter than the black one")
    found: dict[Axis, Coordinates] = {}
    axes: tuple[Axis, ...] = ("x", "y")
    for axis in axes:
        seen = coordinates(samples, patterns, axis)
        if isinstance(seen, str):
            return Objection(PlausibilityStage.SIGNALS, seen)
        if seen is not None:
            found[axis] = seen
    # A mirrored capture with x before y looks like one with y before x and the camera on its side.
    may_be_turned = len(found) > 1 and next(p.axis for p in patterns if not isinstance(p, White | Black)) == "x"
    may_be_turned &= not any(seen.misfit is not None for seen in found.values())
    against = None if may_be_turned else _along_the_other(found)
    return _scattered(found) or against or (_nonsense(samples, found) if len(found) > 1 else None)


def best_fitting(samples: LevelSamples, orders: Sequence[Sequence[Pattern]]) -> list[int]:
    """The numbers of the orders that fit the frames best, if only fringes decide; others fit partly by chance."""
    axes: tuple[Axis, ...] = ("x", "y")
    misfits = []
    for patterns in orders if len(orders) > 1 else ():
        seen = [coordinates(samples, patterns, axis) for axis in axes]
        misfits.append(sum(one.misfit or 0.0 for one in seen if isinstance(one, Coordinates)))
    return [number for number, misfit in enumerate(misfits) if misfit <= _AS_CLOSE * min(misfits)] if misfits else [0]


def _along_the_other(found: dict[Axis, Coordinates]) -> Objection | None:
    """Devices stand roughly upright: x grows along the camera's rows, y along its columns."""
    for axis, seen in found.items():
        farthest = _MOST_APART * _spread(seen)
        steps = [np.abs(after - before) for before, after in _adjacent(seen.values, seen.certain)]
        across, down = (float(np.mean(np.minimum(step, farthest))) if len(step) else 0.0 for step in steps)
        if (across < down) == (axis == "x"):
            return Objection(PlausibilityStage.GEOMETRY, f"the stripes run the other way than those of {axis}")
        right, below = (after - before for before, after in _adjacent(seen.values, seen.certain))
        if seen.misfit is not None and np.median(right if axis == "x" else below) < 0:
            return Objection(PlausibilityStage.GEOMETRY, f"the fringes of {axis} run backwards")
    return None


def _scattered(found: dict[Axis, Coordinates]) -> Objection | None:
    for axis, seen in found.items():
        steps = np.concatenate([np.abs(after - before) for before, after in _adjacent(seen.values, seen.certain)])
        if not len(steps) or np.median(steps) > max(_MOST_APART * _spread(seen), 1.0):
            return Objection(PlausibilityStage.NEIGHBOURS, f"neighbouring pixels have unrelated codes in {axis}")
        if seen.misfit is not None and np.mean(steps > 2 * PLACES_OF_CYCLE * seen.steps) > _MOST_JUMPS:
            return Objection(
                PlausibilityStage.NEIGHBOURS, f"the fringes of {axis} contradict each other: other --periods?"
            )
    return None


def _spread(seen: Coordinates) -> float:
    return float(np.ptp(np.percentile(seen.values[seen.certain], (5, 95))))


def _nonsense(samples: LevelSamples, found: dict[Axis, Coordinates]) -> Objection | None:
    x, y = found["x"], found["y"]
    both = x.certain & y.certain
    if np.count_nonzero(both) < _FEWEST:
        return Objection(PlausibilityStage.SIGNALS, "too few pixels have both codes")
    upright = _upright(x.values, y.values, both)
    if upright < _LEAST_UPRIGHT:
        return Objection(PlausibilityStage.GEOMETRY, f"the codes are mirrored at {1 - upright:.0%} of the pixels")
    projector_px = np.stack([x.values[both] / x.steps, y.values[both] / y.steps], axis=1)
    on_lines = share_on_epipolar_lines(samples.camera_px[both], projector_px)
    if on_lines < _LEAST_ON_LINES:
        return Objection(PlausibilityStage.GEOMETRY, f"only {on_lines:.0%} of the pixels obey one epipolar geometry")
    return None


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
