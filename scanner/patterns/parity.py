"""Bits that nothing else in a sequence proves: those that are shown without their inverses."""

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Sequence

from scanner.patterns.level import kind, level_groups
from scanner.patterns.pattern import Gray, Pattern, Xor


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
