"""Patterns that prove each other: groups that sum to uniform light, and bits whose parity can be shown.

A pattern and its inverse sum to uniform light, and so do all steps of a fringe.
"""

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
from math import isclose

from scanner.patterns.pattern import Black, Gray, Pattern, Phase, White, Xor

_LEAST_STEPS = 3  # with fewer, the sum depends on the projector's response


def level_groups(patterns: Sequence[Pattern]) -> tuple[tuple[int, ...], ...]:
    """Numbers of the patterns of each group that sums to uniform light; steps of a fringe in the order of their shifts.

    A repeated pattern is in no group. The sum does not depend on the projector's response: over a whole cycle, the
    steps take the same levels everywhere. Only harmonics of the order of their number remain, which are small for 3
    steps and zero for 4.
    """
    of: dict[Hashable, list[int]] = defaultdict(list)
    for number, pattern in enumerate(patterns):
        of[kind(pattern)].append(number)
    groups = (sorted(group, key=lambda number: _shift(patterns[number])) for group in of.values())
    return tuple(tuple(group) for group in groups if _is_whole([patterns[number] for number in group]))


def kind(pattern: Pattern) -> Hashable:
    """Return a key that a pattern shares with those that complete it."""
    match pattern:
        case White() | Black():
            return White()
        case Gray() | Xor():
            return replace(pattern, inverted=False)
        case Phase():
            return replace(pattern, shift=0.0)


def _is_whole(group: Sequence[Pattern]) -> bool:
    shifts = [_shift(pattern) for pattern in group]
    if not isinstance(group[0], Phase):
        return len(group) == len(set(group)) == 2
    even = all(isclose(shift - shifts[0], step / len(shifts), abs_tol=1e-6) for step, shift in enumerate(shifts))
    return even and len(shifts) >= _LEAST_STEPS


def _shift(pattern: Pattern) -> float:
    """The shift as a share of a cycle; 0 for patterns without one."""
    return pattern.shift % 1 if isinstance(pattern, Phase) else 0.0


def unpaired_bits(patterns: Sequence[Pattern]) -> tuple[tuple[int, ...], ...]:
    """Numbers of the bits that are in no level group and shown once, in groups of at least two.

    No bit of a group is a combination (exclusive or) of others, so that any combination of wrong pictures changes the
    parity. XOR codes would violate this among the Gray bits that they are made of, since g₀ ⊕ g₁ = x₀ ⊕ x₁.
    """
    paired = {number for group in level_groups(patterns) for number in group}
    counts = Counter(map(kind, patterns))
    codes: dict[Hashable, list[tuple[int, int]]] = defaultdict(list)
    for number, pattern in enumerate(patterns):
        if isinstance(pattern, Gray | Xor) and number not in paired and counts[kind(pattern)] == 1:
            codes[pattern.axis, pattern.bits, pattern.cell, pattern.offset].append((number, _of_gray_bits(pattern)))
    groups = [group for bits in codes.values() for group in _independent(bits)]
    return tuple(sorted(group for group in groups if len(group) > 1))


def _of_gray_bits(pattern: Gray | Xor) -> int:
    """The Gray bits that a bit is the exclusive or of, as the ones of a number."""
    return 1 << pattern.bit | (1 << pattern.base if isinstance(pattern, Xor) else 0)


def _independent(bits: Iterable[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Numbers of bits, in groups that are independent over the field of two elements (Gaussian elimination)."""
    groups: list[list[int]] = [[]]
    reduced: list[int] = []
    for number, combination in bits:
        rest = _rest(combination, reduced)
        if not rest:
            groups.append([])
            reduced, rest = [], combination
        groups[-1].append(number)
        reduced.append(rest)
    return [tuple(group) for group in groups]


def _rest(combination: int, reduced: Iterable[int]) -> int:
    """The remainder of a combination after reduction by those before, each of which has its own highest bit."""
    for known in reduced:
        combination = min(combination, combination ^ known)
    return combination
