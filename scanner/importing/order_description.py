"""Describe an order of patterns in words that distinguish it from other orders."""

from collections.abc import Sequence
from itertools import groupby

from scanner.patterns import Black, Gray, Pattern, Phase, White

_MOST_RUNS = 4  # of patterns along one axis: the fringes, then the codes


def describe_order(patterns: Sequence[Pattern]) -> str:
    """Axes, which bit is first, where inverses are, and where white and black are."""
    bits = [pattern for pattern in patterns if isinstance(pattern, Gray)]
    axes = [axis for axis, _ in groupby(p.axis for p in patterns if isinstance(p, Gray | Phase))]
    by_turns = len(axes) > _MOST_RUNS
    parts = [" and ".join(axes[:2]) + " by turns" if by_turns else ", then ".join(dict.fromkeys(axes))]
    fringes = dict.fromkeys(p.period for p in patterns if isinstance(p, Phase))
    if bits:
        first, second = [p for p in bits if p.axis == bits[0].axis and p.inverted == bits[0].inverted][:2]
        parts += [] if all(bit.cell == 1 for bit in bits) else [describe_cells(bits)]
        parts += ["codes counted from the middle"] if any(bit.offset for bit in bits) and not fringes else []
        parts += ["coarsest bit first" if first.bit < second.bit else "finest bit first", _inverses(bits)]
    if fringes:
        shifts = [p.shift for p in patterns if isinstance(p, Phase)]
        shifted = f"shifted from {shifts[0] % 1:.2g} cycles {'on' if shifts[1] > shifts[0] else 'back'}"
        parts.append(f"fringes of {', '.join(f'{period:.4g}' for period in fringes)} px, {shifted}")
    return "; ".join([*parts, *_ends(patterns)])


def describe_cells(patterns: Sequence[Pattern]) -> str:
    """The lengths of the cells of Gray codes."""
    lengths = dict.fromkeys(f"{p.cell:g}" for p in patterns if isinstance(p, Gray))
    return f"cells of {' and '.join(lengths)} px"


def _inverses(bits: Sequence[Gray]) -> str:
    inverted = [bit.inverted for bit in bits]
    if not any(inverted):
        return "no inverses"
    runs = len([*groupby(inverted)])
    if runs == len(bits):
        return "each bit's inverse after it"
    return "inverses last" if runs == 2 else "inverses after the bits of each axis"


def _ends(patterns: Sequence[Pattern]) -> list[str]:
    names = {White(): "white", Black(): "black"}
    at = [number for number, pattern in enumerate(patterns) if pattern in names]
    if not at:
        return ["no white or black"]
    shown = ", ".join(names[patterns[number]] for number in at)
    return [f"{shown} {'first' if at[0] == 0 else 'last'}"]
