"""Plan a sequence of patterns: sort them by what they measure, and check that this determines the coordinates.

Everything that can be known before the first frame is computed, or refused, here. A sequence that stopped early is
planned anew from its usable frames. Without its finest bits a Gray code is one of longer cells, whose edges are still
located; a fringe without all of its steps is left out.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, sqrt

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from scanner.decoding.light.exposures import exposures_of
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


_AXES: tuple[Axis, Axis] = ("x", "y")
# Accuracy (68 %) between stripe edges of plain codes in simulated rooms: 0.02 px with cells of 1 to 4 px, 0.03 with 8,
# 0.05 with 16, 0.1 with 32.
_BETWEEN_EDGES_PX, _OF_CELL = 0.05, 0.1 / 32

STOPPED_EARLY = FindingKind(
    "stopped-early",
    "The capture lacks its last patterns; it was decoded from what there is, less finely.",
    "Complete it with scan --resume, or capture again.",
    ("taken_frames", "planned_frames"),
)


@dataclass(frozen=True)
class Usable:
    """Usable frames of a capture.

    `patterns`: what each frame is decoded as, None if it is left out. `finding`: what is missing and what it costs;
    None if nothing is.
    """

    patterns: tuple[Pattern | None, ...]
    finding: Finding | None = None


def usable(
    patterns: Sequence[Pattern],
    planned: Sequence[Pattern],
    projector_size: tuple[int, int],
    *,
    calibrated: bool = False,
) -> Usable:
    """Return what the frames of a capture determine; `planned`: the patterns that were to be taken, empty if unknown.

    For a `calibrated` rig one axis is enough. Raises InputError with what is missing if they determine too little.
    """
    if len(planned) > len(patterns):
        return _trimmed(patterns, planned, projector_size, calibrated=calibrated)
    try:
        plan_sequence(exposures_of(patterns)[0], projector_size, calibrated=calibrated)
    except InputError as lacking:
        try:
            return _trimmed(patterns, (), projector_size, calibrated=calibrated)
        except InputError:
            raise lacking from None
    return Usable(tuple(patterns))


def _trimmed(
    patterns: Sequence[Pattern], planned: Sequence[Pattern], size: tuple[int, int], *, calibrated: bool
) -> Usable:
    count = _exposures(planned or patterns)
    whole = patterns[: len(patterns) // count * count]
    once, wanted = tuple(dict.fromkeys(whole)), tuple(dict.fromkeys(planned or patterns))
    axes = [_decodable(axis, length, once, wanted) for axis, length in zip(_AXES, size, strict=True)]
    axes = _balanced(axes, wanted, calibrated=calibrated)
    decoded_as = {p: p for p in once if not isinstance(p, Gray | Xor | Phase)} | axes[0] | axes[1]
    plan: SequencePlan | None = None
    troubles = []
    # The codes alone only if the fringes repeat within the remaining cells.
    for choice in (_only_codes(decoded_as), decoded_as):
        try:
            plan = plan_sequence([choice[p] for p in once if p in choice], size, calibrated=calibrated)
            decoded_as = choice
        except InputError as error:
            troubles.append(error)
    taken = f"{len(patterns)} of its {len(planned)} frames were taken. " if planned else ""
    missing = f"The capture stops early: {taken}Missing or left out: {_listed(wanted, decoded_as)}"
    if plan is None:
        raise InputError(f"{missing}. From what there is nothing can be decoded: {troubles[-1]}")
    kept = (decoded_as.get(pattern) for pattern in patterns[: len(whole)])
    costs = "; ".join(_cost(axis, by_edges=not plan.fringes) for axis in plan.axes)
    numbers = {"taken_frames": float(len(patterns)), "planned_frames": float(len(planned))} if planned else {}
    finding = Finding(STOPPED_EARLY, Severity.WARNING, f"{missing}. What it costs: {costs}.", data=numbers)
    return Usable((*kept, *[None] * (len(patterns) - len(whole))), finding)


def _exposures(patterns: Sequence[Pattern]) -> int:
    """Return the number of successive frames of each pattern; the last ones may be missing."""
    count = next((n for n, pattern in enumerate(patterns) if pattern != patterns[0]), 1)
    return count if exposures_of(patterns[: len(patterns) // count * count])[1] == count else 1


def _decodable(axis: Axis, length: int, once: Sequence[Pattern], wanted: Sequence[Pattern]) -> dict[Pattern, Pattern]:
    """Return the patterns along an axis that can be decoded, and what each is decoded as."""
    decoded_as: dict[Pattern, Pattern] = {}
    codes: dict[tuple[int, float, float], list[Gray]] = defaultdict(list)
    relative: dict[tuple[int, float, float, int], list[Xor]] = defaultdict(list)
    for pattern in once:
        if isinstance(pattern, Gray) and pattern.axis == axis:
            codes[pattern.bits, pattern.cell, pattern.offset].append(pattern)
        elif isinstance(pattern, Xor) and pattern.axis == axis:
            relative[pattern.bits, pattern.cell, pattern.offset, pattern.base].append(pattern)
    for (bits, cell, offset), patterns in codes.items():
        for lost in range(bits):
            code = bits - lost, cell * 2**lost, offset
            kept = [pattern for pattern in patterns if pattern.bit < code[0]]
            if kept and _complete(axis, length, code, {pattern.bit for pattern in kept}):
                decoded_as |= {pattern: replace(pattern, bits=code[0], cell=code[1]) for pattern in kept}
                break
    for (bits, cell, offset, base), xors in relative.items():
        relative_bits = {pattern.bit for pattern in xors}
        plain = [pattern for pattern in codes[bits, cell, offset] if pattern.bit not in relative_bits]
        plain_bits = {pattern.bit for pattern in plain}
        if base in plain_bits and _complete(axis, length, (bits, cell, offset), plain_bits | relative_bits):
            whole: list[Pattern] = [*plain, *xors]
            decoded_as |= {pattern: pattern for pattern in whole}
    return decoded_as | {pattern: pattern for pattern in _whole_fringes(axis, once, wanted)}


def _complete(axis: Axis, length: int, code: tuple[int, float, float], bits: set[int]) -> bool:
    try:
        constant_bits(axis, length, code, bits)
    except InputError:
        return False
    return True


def _whole_fringes(axis: Axis, once: Sequence[Pattern], wanted: Sequence[Pattern]) -> list[Phase]:
    """Return the fringes with all steps that were planned, and with as many as any other has."""
    steps, taken = (
        Counter((pattern.axis, pattern.period) for pattern in patterns if isinstance(pattern, Phase))
        for patterns in (wanted, once)
    )
    whole = {fringe for fringe, count in taken.items() if count == steps[fringe] == max(steps.values())}
    return [p for p in once if isinstance(p, Phase) and p.axis == axis and (axis, p.period) in whole]


def _balanced(
    axes: list[dict[Pattern, Pattern]], wanted: Iterable[Pattern], *, calibrated: bool
) -> list[dict[Pattern, Pattern]]:
    """Adjust the axes to each other where one is cut short to cells.

    The other one is then best reduced to cells as well, so that matches are averaged; or the cut axis is dropped, if
    the calibration determines it better.
    """
    codes = [pattern for pattern in wanted if isinstance(pattern, Gray)]
    fine = [any(isinstance(pattern, Phase) for pattern in decoded_as) for decoded_as in axes]
    cut = [
        any(decoded_as.get(p) != p for p in codes if p.axis == axis)
        for axis, decoded_as in zip(_AXES, axes, strict=True)
    ]
    for first, second in ((0, 1), (1, 0)):
        if fine[first] or not axes[second]:
            continue
        if calibrated and (fine[second] or (cut[first] and not cut[second])):
            axes[first] = {}
        elif axes[first] and fine[second]:
            axes[second] = _only_codes(axes[second])
    return axes


def _only_codes(decoded_as: dict[Pattern, Pattern]) -> dict[Pattern, Pattern]:
    return {pattern: kept for pattern, kept in decoded_as.items() if not isinstance(pattern, Phase)}


def _listed(wanted: Sequence[Pattern], decoded_as: Collection[Pattern]) -> str:
    """List what is not decoded, by axis and kind."""
    bits: dict[str, set[int]] = defaultdict(set)
    fringes: dict[Axis, set[float]] = defaultdict(set)
    for pattern in wanted:
        if pattern in decoded_as:
            continue
        match pattern:
            case Gray() | Xor():
                bits[f"{type(pattern).__name__} code along {pattern.axis}"].add(pattern.bit)
            case Phase():
                fringes[pattern.axis].add(pattern.period)
    codes = [f"bits {', '.join(map(str, sorted(numbers)))} of the {code}" for code, numbers in bits.items()]
    steps = [
        f"the fringes along {axis} of {' and '.join(f'{period:g}' for period in sorted(periods, reverse=True))} px"
        for axis, periods in fringes.items()
    ]
    return ", ".join([*codes, *steps]) or "the last frames"


def _cost(plan: AxisPlan, *, by_edges: bool) -> str:
    """Describe the accuracy of one axis; `by_edges`: edges of plain codes are kept, as without fringes."""
    if not plan.is_measured:
        return f"{plan.axis} follows from the calibration"
    if plan.fringes:
        return f"{plan.axis} comes from fringes of {' and '.join(f'{fringe.period:g}' for fringe in plan.fringes)} px"
    cells = f"cells of {plan.cell:g} projector px (± {plan.cell / sqrt(12):.1f} px)"
    if not by_edges or all(code.base is not None for code in plan.codes):
        return f"{plan.axis} is known to {cells}"
    between_px = max(_BETWEEN_EDGES_PX, _OF_CELL * plan.cell)
    return (
        f"{plan.axis} is known to some {between_px:.2g} projector px between the edges of stripes, where surfaces are "
        f"smooth and lenses show them sharply, and elsewhere to {cells}"
    )
