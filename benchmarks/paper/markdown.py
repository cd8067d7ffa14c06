"""Helpers of the page: tables, numbers, means."""

from collections.abc import Iterable, Sequence

import numpy as np

from scanner.quantities import plain

NONE = "–"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    first, *others = ("| " + " | ".join(line) + " |" for line in (head, *rows))
    return "\n".join([first, "|---" * len(head) + "|", *others])


def number(value: float | None, *, signed: bool = False) -> str:
    """Format with about two significant digits, and all before the point."""
    if value is None:
        return NONE
    size = abs(value)
    decimals = 3 if size < 0.1 else 2 if size < 1 else 1 if size < 100 else 0
    return plain(value, decimals, signed=signed)


def mean_size(errors: Sequence[float] | None) -> float | None:
    """Mean absolute error; None without an answer."""
    return None if errors is None else float(np.abs(errors).mean())


def mean_of(values: Iterable[float | None]) -> float | None:
    """Mean of the existing values; None without any."""
    there = [value for value in values if value is not None]
    return float(np.mean(there)) if there else None


def answered(values: Sequence[object]) -> str:
    """A note on the number of missing values; empty if none."""
    missing = sum(value is None for value in values)
    return f" ({missing} of {len(values)} refused)" if missing else ""


def image(path: str, alt: str) -> str:
    return f"![{alt}]({path})"


def method_name(key: str) -> str:
    """A method's name on the page; 'paper' alone would be the text itself."""
    return f"the paper's method{key.removeprefix('paper')}" if key.startswith("paper") else key
