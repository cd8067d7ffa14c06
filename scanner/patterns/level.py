"""Patterns that light every place alike together: a pattern and its inverse, all steps of a fringe."""

from collections.abc import Sequence
from dataclasses import replace
from math import isclose

from scanner.patterns.pattern import Black, Gray, Pattern, Phase, White, Xor

_LEAST_STEPS = 3  # of fewer, the sum depends on how light follows the picture's grey levels


def level_groups(patterns: Sequence[Pattern]) -> tuple[range, ...]:
    """The numbers of patterns that follow each other and light every place alike together, in order.

    That does not depend on how bright the projector makes a grey level: the steps of a whole cycle go through the same
    levels everywhere, but for harmonics of the order of their number, which are small for 3 and nothing for 4.
    """
    groups, number = [], 0
    while number < len(patterns):
        count = 2 if _inverse(patterns[number : number + 2]) else _steps(patterns[number:])
        groups += [range(number, number + count)] if count > 1 else []
        number += max(1, count)
    return tuple(groups)


def _inverse(pair: Sequence[Pattern]) -> bool:
    match pair:
        case [White(), Black()] | [Black(), White()]:
            return True
        case [Gray() | Xor() as one, Gray() | Xor() as other]:
            return replace(one, inverted=not one.inverted) == other
    return False


def _steps(patterns: Sequence[Pattern]) -> int:
    """How many of the first patterns are the steps of one fringe over a cycle; 0 if they are not."""
    first = patterns[0]
    if not isinstance(first, Phase):
        return 0
    fringe = [first]
    for pattern in patterns[1:]:
        if not isinstance(pattern, Phase) or (pattern.axis, pattern.period) != (first.axis, first.period):
            break
        fringe.append(pattern)
    shifts = sorted((pattern.shift - first.shift) % 1 for pattern in fringe)
    even = all(isclose(shift, step / len(shifts), abs_tol=1e-6) for step, shift in enumerate(shifts))
    return len(fringe) if even and len(fringe) >= _LEAST_STEPS else 0
