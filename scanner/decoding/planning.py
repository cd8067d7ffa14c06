"""Plan a sequence of patterns: sort them by what they measure, and check that this determines the coordinates.

Everything that can be known before the first frame is computed, or refused, here.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil, inf

import numpy as np

from scanner.decoding.sequence_plan import AxisPlan, Fringe, GrayCode, SequencePlan
from scanner.errors import InputError
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, Xor

# Two fringe orders are distinct if, for some period, they differ by at least this fraction of it.
_DISTINCT_CYCLES = 0.05

# Bits, cell and offset of a Gray code; and its frames by (inverted, bit).
_Numbering = tuple[int, float, float]
_Shown = dict[bool, dict[int, int]]


def plan_sequence(
    patterns: Sequence[Pattern], projector_size: tuple[int, int], *, calibrated: bool = False
) -> SequencePlan:
    """Sort a sequence by what its patterns measure on a projector of (width, height).

    For a `calibrated` rig one axis is enough. Raises InputError if a bit or shift is missing, or a coordinate is not
    determined.
    """
    index: dict[Pattern, int] = {}
    order = tuple(index.setdefault(pattern, len(index)) for pattern in patterns)
    width, height = projector_size
    x, y = _plan_axis("x", width, index), _plan_axis("y", height, index)
    _require_measured(x, y, calibrated=calibrated)
    return SequencePlan(tuple(index), x, y, index.get(White()), index.get(Black()), order)


def _plan_axis(axis: Axis, length: int, index: Mapping[Pattern, int]) -> AxisPlan:
    codes = tuple(_gray_codes(axis, length, index))
    fringes = tuple(sorted(_fringes(axis, index), key=lambda fringe: -fringe.period))
    plan = AxisPlan(axis, length, codes, fringes)
    if plan.is_measured:
        _require_determined(plan)
    return plan


def _gray_codes(axis: Axis, length: int, index: Mapping[Pattern, int]) -> list[GrayCode]:
    plain: dict[_Numbering, _Shown] = defaultdict(_nothing)
    relative: dict[tuple[_Numbering, int], _Shown] = defaultdict(_nothing)
    for pattern, frame in index.items():
        if isinstance(pattern, Gray | Xor) and pattern.axis == axis:
            numbering = pattern.bits, pattern.cell, pattern.offset
            group = relative[numbering, pattern.base] if isinstance(pattern, Xor) else plain[numbering]
            group[pattern.inverted][pattern.bit] = frame
    codes = []
    of_xor: set[tuple[_Numbering, int]] = set()
    for (numbering, base), frames_of in relative.items():
        bits = frozenset({*frames_of[False], *frames_of[True]})
        # The base, and the finer bits that are not relative to it, are shown plainly.
        for inverted, frames in plain[numbering].items():
            frames_of[inverted] |= {bit: frame for bit, frame in frames.items() if bit not in bits}
        if not any(base in frames for frames in frames_of.values()):
            raise InputError(f"an XOR code along {axis} needs its base as well, the Gray code's bit {base}")
        codes.append(replace(_code(axis, length, numbering, frames_of), base=base, relative=bits))
        of_xor |= {(numbering, bit) for bit in {*frames_of[False], *frames_of[True]} - bits}
    # Bits that only belong to an XOR code are no Gray code of their own.
    for numbering, frames_of in plain.items():
        if {(numbering, bit) for bit in {*frames_of[False], *frames_of[True]}} - of_xor:
            codes.append(_code(axis, length, numbering, frames_of))
    return codes


def _nothing() -> _Shown:
    return {False: {}, True: {}}


def _code(axis: Axis, length: int, numbering: _Numbering, frames_of: _Shown) -> GrayCode:
    constant = constant_bits(axis, length, numbering, {*frames_of[False], *frames_of[True]})
    return GrayCode(axis, *numbering, frames_of[False], frames_of[True], constant)


def constant_bits(axis: Axis, length: int, key: tuple[int, float, float], bits_shown: set[int]) -> int:
    """Return the value of the bits that were not shown; `key`: a code's bits, cell and offset.

    Raises InputError if such a bit is not constant along the axis, or the code does not fit it.
    """
    bits, cell, offset = key
    if bits > (most := np.iinfo(np.uint32).bits):
        raise InputError(f"a Gray code of {bits} bits along {axis}; at most {most} are read")
    if not all(0 <= bit < bits for bit in bits_shown):
        raise InputError(f"bits of a Gray code along {axis} must be 0 … {bits - 1}, found {sorted(bits_shown)}")
    n = np.floor((np.arange(length) + offset) / cell).astype(np.int64)
    if n[0] < 0 or n[-1] >= 1 << bits:
        raise InputError(
            f"the Gray code along {axis} (cell {cell}, offset {offset}) counts from {n[0]} to {n[-1]} on {length} px; "
            f"with {bits} bits it is unique from 0 to {(1 << bits) - 1} only"
        )
    words = n ^ (n >> 1)
    changing = int(np.bitwise_or.reduce(words) ^ np.bitwise_and.reduce(words)) & ((1 << bits) - 1)
    missing = [bit for bit in range(bits) if bit not in bits_shown]
    lacking = [bit for bit in missing if changing >> (bits - 1 - bit) & 1]
    if lacking:
        numbers = ", ".join(map(str, lacking))
        raise InputError(
            f"the Gray code along {axis} (cell {cell}, offset {offset}) has {bits} bits, but no frame shows bit "
            f"{numbers}"
        )
    return sum(int(words[0]) & (1 << (bits - 1 - bit)) for bit in missing)


def _fringes(axis: Axis, index: Mapping[Pattern, int]) -> list[Fringe]:
    groups: dict[float, list[tuple[float, int]]] = defaultdict(list)
    for pattern, frame in index.items():
        if isinstance(pattern, Phase) and pattern.axis == axis:
            groups[pattern.period].append((pattern.shift, frame))
    fringes = []
    for period, steps in groups.items():
        fringe = Fringe(axis, period, tuple(shift for shift, _ in steps), tuple(frame for _, frame in steps))
        angles = np.unique(np.round(np.mod(fringe.shifts, 1), 6) % 1)
        if len(angles) < 3 or fringe.noise_gain > 3:
            raise InputError(
                f"a phase along {axis} needs at least three well spread shifts; period {period:g} has "
                f"{', '.join(f'{shift:g}' for shift in fringe.shifts)}"
            )
        fringes.append(fringe)
    return fringes


def _require_measured(x: AxisPlan, y: AxisPlan, *, calibrated: bool) -> None:
    missing = [plan.axis for plan in (x, y) if not plan.is_measured]
    if len(missing) == 2:
        raise InputError("no pattern varies along x or y; a Gray code or fringes are needed")
    if missing and not calibrated:
        raise InputError(
            f"no pattern varies along {missing[0]}; a Gray code or fringes along {missing[0]} are needed, or else the "
            "rig's calibration (scan replay CAPTURE --calibration FILE), whose epipolar lines tell the other coordinate"
        )


def _require_determined(plan: AxisPlan) -> None:
    periods = [fringe.period for fringe in plan.fringes]
    repeat = repeat_length(periods, plan.length)
    if plan.fringes and repeat < plan.cell * (1 - 1e-9):
        listed = ", ".join(f"{period:g}" for period in periods)
        cells = f"its Gray cells are {plan.cell:g} px long" if plan.codes else "there is no Gray code"
        raise InputError(
            f"the {plan.axis} coordinate is not determined: fringes of period {listed} px repeat every {repeat:g} px, "
            f"and {cells}; add a Gray code with cells of at most {repeat:g} px, or a period of at least {plan.length} "
            "px"
        )


def repeat_length(periods: Sequence[float], length: int) -> float:
    """Return the distance, up to `length`, after which fringes of these periods (longest first) repeat; inf if they do
    not.
    """
    if not periods:
        return inf
    for order in range(1, ceil(length / periods[0])):
        distance = order * periods[0]
        cycles = distance / np.array(periods[1:])
        if np.all(np.abs(cycles - np.rint(cycles)) < _DISTINCT_CYCLES):
            return distance
    return inf
