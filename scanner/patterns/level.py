"""Groups of patterns that sum to uniform light: a pattern and its inverse, all steps of a fringe."""

from collections import defaultdict
from collections.abc import Hashable, Sequence
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
