"""Describe an order of patterns in words that distinguish it from other orders."""

from collections.abc import Sequence
from itertools import groupby

from scanner.patterns import Black, Gray, Pattern, Phase, White


def describe_order(patterns: Sequence[Pattern]) -> str:
    """Axes, which bit is first, where inverses are, and where white and black are."""
    bits = [pattern for pattern in patterns if isinstance(pattern, Gray)]
    axes = dict.fromkeys(p.axis for p in patterns if isinstance(p, Gray | Phase))
    parts = [", then ".join(axes)]
    if bits:
        first, second = [p for p in bits if p.axis == bits[0].axis and p.inverted == bits[0].inverted][:2]
        parts += ["coarsest bit first" if first.bit < second.bit else "finest bit first", _inverses(bits)]
    fringes = dict.fromkeys(p.period for p in patterns if isinstance(p, Phase))
    if fringes:
        shifts = [p.shift for p in patterns if isinstance(p, Phase)]
        shifted = f"shifted from {shifts[0] % 1:.2g} cycles {'on' if shifts[1] > shifts[0] else 'back'}"
        parts.append(f"fringes of {', '.join(f'{period:.4g}' for period in fringes)} px, {shifted}")
    return "; ".join([*parts, *_ends(patterns)])


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
