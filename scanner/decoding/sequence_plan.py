"""What a sequence of patterns measures: Gray codes and fringes per axis, and whether they determine the coordinates.

Everything that can be known before the first frame is worked out, or refused, here.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, inf

import numpy as np

from calib.numerics import Floats
from scanner.decoding.arrays import Words
from scanner.errors import InputError
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, Xor

_MAX_BITS = 32
_MOST_NAMED = 12
# Two fringe orders can be told apart if some period sees them at least this fraction of itself apart.
_DISTINCT_CYCLES = 0.05


# Bits, cell and offset of a Gray code; and its frames, by whether they are inverted, and by bit.
_Numbering = tuple[int, int, int]
_Shown = dict[bool, dict[int, int]]


@dataclass(frozen=True)
class GrayCode:
    """The bits of one Gray code. `normal` and `inverse` map a bit to the index of its frame.

    `constant` is the part of the code word that never changes on this projector and was not shown. `base`: the bit
    that all others are shown relative to, by exclusive or (an XOR code); None for a plain Gray code.
    """

    axis: Axis
    bits: int
    cell: int
    offset: int
    normal: Mapping[int, int]
    inverse: Mapping[int, int]
    constant: int = 0
    base: int | None = None

    def relative_to_base(self, words: Words) -> Words:
        """The words of the plain code from those that an XOR code shows, and the other way round; any shape."""
        if self.base is None:
            return words
        shown = sum(1 << self.bits - 1 - bit for bit in {*self.normal, *self.inverse} - {self.base})
        base = words >> words.dtype.type(self.bits - 1 - self.base) & words.dtype.type(1)
        return words ^ base * words.dtype.type(shown)

    def without_finest(self, count: int) -> "GrayCode":
        """The code of longer cells that is left without its finest bits."""
        bits = self.bits - count
        normal, inverse = ({b: f for b, f in frames.items() if b < bits} for frames in (self.normal, self.inverse))
        constant = self.constant >> count
        return replace(self, bits=bits, cell=self.cell << count, normal=normal, inverse=inverse, constant=constant)

    @property
    def pairs(self) -> dict[int, tuple[int, int]]:
        """Bit → frames of the pattern and of its inverse, for the bits that have both."""
        return {bit: (self.normal[bit], self.inverse[bit]) for bit in self.normal if bit in self.inverse}

    @property
    def unpaired(self) -> dict[int, int]:
        """Bit → its only frame, be it the pattern or the inverse."""
        alone = {bit: frame for bit, frame in self.normal.items() if bit not in self.inverse}
        return alone | {bit: frame for bit, frame in self.inverse.items() if bit not in self.normal}

    @property
    def frames(self) -> list[int]:
        """All frames, in order."""
        return sorted([*self.normal.values(), *self.inverse.values()])


@dataclass(frozen=True)
class Fringe:
    """One period in all its shifts (cycles), in the order of `frames`."""

    axis: Axis
    period: float
    shifts: tuple[float, ...]
    frames: tuple[int, ...]

    @cached_property
    def weights(self) -> Floats:
        """(3, N): least squares of offset, a cos θ and a sin θ in I = offset + a cos(θ + 2π shift)."""
        angles = 2 * np.pi * np.array(self.shifts)
        design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)
        return np.linalg.pinv(design)

    @property
    def noise_gain(self) -> float:
        """Standard deviation of the two components of the fringe per grey level of noise; √(2/N) for equal shifts."""
        return float(np.sqrt(np.mean(np.sum(self.weights[1:] ** 2, axis=1))))

    @property
    def equal_steps(self) -> bool:
        """Whether the shifts divide the cycle evenly, so that only harmonics next to multiples of N bend the phase."""
        steps = np.diff(np.sort(np.mod(np.array(self.shifts) + 1e-9, 1)))
        return bool(np.allclose(steps, 1 / len(self.shifts), atol=1e-6))


@dataclass(frozen=True)
class AxisPlan:
    """How one projector coordinate is measured. `fringes` from the longest period to the shortest."""

    axis: Axis
    length: int
    codes: tuple[GrayCode, ...]
    fringes: tuple[Fringe, ...]

    @property
    def is_measured(self) -> bool:
        """Whether any pattern varies along it."""
        return bool(self.codes or self.fringes)

    @property
    def cell(self) -> float:
        """The length that the Gray codes leave undetermined."""
        return min((code.cell for code in self.codes), default=self.length)

    @property
    def corrects_bits(self) -> bool:
        """Whether a second period contradicts a wrong bit of the Gray code."""
        return len(self.fringes) > 1

    @property
    def frames(self) -> list[int]:
        """All frames of this axis, in order."""
        of_codes = [frame for code in self.codes for frame in code.frames]
        return sorted({*of_codes, *(frame for fringe in self.fringes for frame in fringe.frames)})


@dataclass(frozen=True)
class SequencePlan:
    """The whole sequence. `white` and `black` are frame indices or None.

    Frames are counted as if each pattern had one; `repeats` is how many it has, of different exposures. `shown`: which
    pattern each frame shows; one that was shown before tells what has changed since.
    """

    patterns: tuple[Pattern, ...]
    x: AxisPlan
    y: AxisPlan
    white: int | None
    black: int | None
    shown: tuple[int, ...]
    repeats: int = 1

    @property
    def frame_count(self) -> int:
        """How many frames the capture has."""
        return self.repeats * len(self.shown)

    @property
    def axes(self) -> tuple[AxisPlan, AxisPlan]:
        """Both axes."""
        return self.x, self.y

    @property
    def only_axis(self) -> AxisPlan | None:
        """The axis that is measured, if the other one is not."""
        return None if self.x.is_measured and self.y.is_measured else self.x if self.x.is_measured else self.y

    @property
    def codes(self) -> tuple[GrayCode, ...]:
        """The Gray codes of both axes."""
        return self.x.codes + self.y.codes

    @property
    def fringes(self) -> tuple[Fringe, ...]:
        """The fringes of both axes."""
        return self.x.fringes + self.y.fringes

    @property
    def complements(self) -> list[tuple[int, int]]:
        """Pairs of frames whose light adds up to white plus black: patterns and inverses, and white and black."""
        pairs = [*dict.fromkeys(pair for code in self.codes for pair in code.pairs.values())]
        if self.white is not None and self.black is not None:
            pairs.append((self.white, self.black))
        return pairs

    def name(self, frame: int) -> str:
        """A frame and its pattern, for messages."""
        number = self.shown.index(frame) * self.repeats
        return f"frame {number} ({describe(self.patterns[frame])})"

    def names(self, frames: Sequence[int]) -> str:
        """Frames and their patterns, for messages."""
        chosen = sorted(set(frames))
        shown = ", ".join(self.name(frame) for frame in chosen[:_MOST_NAMED])
        return shown if len(chosen) <= _MOST_NAMED else f"{shown} and {len(chosen) - _MOST_NAMED} more"


def describe(pattern: Pattern) -> str:
    """A pattern in a few words."""
    match pattern:
        case White():
            return "white"
        case Black():
            return "black"
        case Gray():
            return f"gray {pattern.axis} bit {pattern.bit}{' inverted' if pattern.inverted else ''}"
        case Xor():
            return f"xor {pattern.axis} bit {pattern.bit} base {pattern.base}{' inverted' if pattern.inverted else ''}"
        case Phase():
            return f"phase {pattern.axis} period {pattern.period:g} shift {pattern.shift:g}"


def plan_sequence(
    patterns: Sequence[Pattern], projector_size: tuple[int, int], *, calibrated: bool = False
) -> SequencePlan:
    """Sort a sequence by what its patterns measure on a projector of (width, height).

    Of a rig that is `calibrated` one of the coordinates is enough. Raises InputError where a bit or shift is missing,
    or a coordinate is not determined.
    """
    index: dict[Pattern, int] = {}
    shown = tuple(index.setdefault(pattern, len(index)) for pattern in patterns)
    width, height = projector_size
    x, y = _plan_axis("x", width, index), _plan_axis("y", height, index)
    _require_measured(x, y, calibrated=calibrated)
    return SequencePlan(tuple(index), x, y, index.get(White()), index.get(Black()), shown)


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
    for (numbering, base), shown in relative.items():
        for inverted in (False, True):
            if base in plain[numbering][inverted]:
                shown[inverted][base] = plain[numbering][inverted][base]
        if not any(base in frames for frames in shown.values()):
            raise InputError(f"an XOR code along {axis} needs its base as well, the Gray code's bit {base}")
        codes.append(_code(axis, length, numbering, shown, base))
    # A bit that is shown as the base of an XOR code only is no Gray code.
    bases = {(numbering, base) for numbering, base in relative}
    for numbering, shown in plain.items():
        if {(numbering, bit) for bit in {*shown[False], *shown[True]}} - bases:
            codes.append(_code(axis, length, numbering, shown, None))
    return codes


def _nothing() -> _Shown:
    return {False: {}, True: {}}


def _code(axis: Axis, length: int, numbering: _Numbering, shown: _Shown, base: int | None) -> GrayCode:
    constant = constant_bits(axis, length, numbering, {*shown[False], *shown[True]})
    return GrayCode(axis, *numbering, shown[False], shown[True], constant, base)


def constant_bits(axis: Axis, length: int, key: tuple[int, int, int], shown: set[int]) -> int:
    """The value of the bits that were not shown, which must be the same on all pixels of the axis; `key`: a code's
    bits, cell and offset. Raises InputError.
    """
    bits, cell, offset = key
    if bits > _MAX_BITS:
        raise InputError(f"a Gray code of {bits} bits along {axis}; at most {_MAX_BITS} are read")
    if not all(0 <= bit < bits for bit in shown):
        raise InputError(f"bits of a Gray code along {axis} must be 0 … {bits - 1}, found {sorted(shown)}")
    n = (np.arange(length) + offset) // cell
    if n[0] < 0 or n[-1] >= 1 << bits:
        raise InputError(
            f"the Gray code along {axis} (cell {cell}, offset {offset}) counts from {n[0]} to {n[-1]} on {length} px; "
            f"with {bits} bits it is unique from 0 to {(1 << bits) - 1} only"
        )
    words = n ^ (n >> 1)
    changing = int(np.bitwise_or.reduce(words) ^ np.bitwise_and.reduce(words)) & ((1 << bits) - 1)
    missing = [bit for bit in range(bits) if bit not in shown]
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
    for period, shown in groups.items():
        fringe = Fringe(axis, period, tuple(shift for shift, _ in shown), tuple(frame for _, frame in shown))
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
        shown = ", ".join(f"{period:g}" for period in periods)
        left = f"its Gray cells are {plan.cell:g} px long" if plan.codes else "there is no Gray code"
        raise InputError(
            f"the {plan.axis} coordinate is not determined: fringes of period {shown} px repeat every {repeat:g} px, "
            f"and {left}; add a Gray code with cells of at most {repeat:g} px, or a period of at least {plan.length} px"
        )


def repeat_length(periods: Sequence[float], length: int) -> float:
    """After how many pixels, up to `length`, fringes of these periods (longest first) look alike again; else inf."""
    if not periods:
        return inf
    for order in range(1, ceil(length / periods[0])):
        distance = order * periods[0]
        cycles = distance / np.array(periods[1:])
        if np.all(np.abs(cycles - np.rint(cycles)) < _DISTINCT_CYCLES):
            return distance
    return inf
