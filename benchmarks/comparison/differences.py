"""Differences between the contents of two files, as sentences."""

from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comparison.readers import Lines, Unordered, read

_SMALLEST = 1e-7  # of an array's largest number: below it, rounding of the largest is more than 1e-9
_LONGEST, _MOST_LINES = 160, 2000  # characters of a changed text that are shown; lines that are compared one by one


def folder_differences(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    """Differences of all files of two folders."""
    names = [
        {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} for folder in (before, after)
    ]
    for name in sorted(names[0] ^ names[1]):
        yield f"{name} is only {_side(name in names[0])}"
    for name in sorted(names[0] & names[1]):
        if (before / name).read_bytes() != (after / name).read_bytes():
            for difference in differences(read(before / name), read(after / name), tolerance):
                yield f"{name}: {difference}"


def differences(before: Any, after: Any, tolerance: float, where: str = "") -> Iterator[str]:
    """Differences of two contents, by the keys of `where` they are.

    Dicts and lists are compared part by part; what only one of them has is one difference. Numbers differ if they are
    apart by more than `tolerance` of their size.
    """
    if isinstance(before, dict) and isinstance(after, dict):
        for key in [*before, *(key for key in after if key not in before)]:
            inside = f"{where}.{key}".lstrip(".")
            if key in before and key in after:
                yield from differences(before[key], after[key], tolerance, inside)
            else:
                yield f"{inside} is only {_side(key in before)}"
    elif (numbers := _as_numbers(before)) is not None and (others := _as_numbers(after)) is not None:
        yield from (f"{where} {off}".lstrip() for off in _number_differences(numbers, others, tolerance))
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield f"{where} has {len(before)} entries before, {len(after)} after".lstrip()
        for number, (first, second) in enumerate(zip(before, after, strict=False)):
            yield from differences(first, second, tolerance, f"{where}.{number}".lstrip("."))
    elif isinstance(before, Unordered) and isinstance(after, Unordered):
        yield from (f"{where} {difference}".lstrip() for difference in _mesh_differences(before, after, tolerance))
    elif isinstance(before, Lines) and isinstance(after, Lines):
        yield from (f"{where} {change}".lstrip() for change in _changes(before.lines, after.lines, "\n"))
    elif isinstance(before, str) and isinstance(after, str):
        yield from (f"{where} {change}".lstrip() for change in _changes(before.split(), after.split(), " "))
    elif type(before) is not type(after) or before != after:
        yield f"{where} {_shown(before)} is now {_shown(after)}".lstrip()


def _side(is_before: bool) -> str:
    return "before" if is_before else "after"


def _shown(value: Any) -> str:
    text = f"{len(value)} bytes" if isinstance(value, bytes) else str(value)
    return f"“{text if len(text) <= _LONGEST else f'{text[:_LONGEST]}…'}”"


def _as_numbers(value: Any) -> NDArray[Any] | None:
    """A number, or numbers in lists of equal lengths, as an array."""
    if (
        isinstance(value, str | bytes | dict | Lines | Unordered)
        or value is None
        or (isinstance(value, list) and not value)
    ):
        return None
    try:
        array = np.asarray(value)
    except ValueError:  # lists of different lengths
        return None
    return array if array.dtype.kind in "biuf" else None


def _number_differences(before: NDArray[Any], after: NDArray[Any], tolerance: float) -> Iterator[str]:
    """The size of a number of an array counts as 1e-7 of the largest at least; a number in single precision may be one
    step of it further off.
    """
    if before.shape != after.shape:
        yield f"has the shape {before.shape} before, {after.shape} after"
        return
    a, b = (values.astype(np.float64).ravel() for values in (before, after))
    finite = np.isfinite(a) & np.isfinite(b)
    size = np.maximum(np.abs(a), np.abs(b))
    size = np.maximum(size, _SMALLEST * np.max(size, where=finite, initial=0.0))
    single = before.dtype == after.dtype == np.float32
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.abs(a - b) / size  # NaN where both are zero
    allowed = tolerance + (np.finfo(np.float32).eps if single else 0.0)
    differs = np.where(finite, off > allowed, ~((a == b) | (np.isnan(a) & np.isnan(b))))
    if np.any(differs):
        worst = int(np.argmax(np.where(differs, np.where(finite, off, np.inf), -1.0)))
        many = f"{np.count_nonzero(differs):,} of {a.size:,} numbers, " if a.size > 1 else ""
        size_off = f", off by {off[worst]:.2g} of its size" if finite[worst] else ""
        yield f"differs: {many}{a[worst]:.10g} is now {b[worst]:.10g}{size_off}"


def _mesh_differences(before: Unordered, after: Unordered, tolerance: float) -> Iterator[str]:
    if before.points.shape != after.points.shape or before.triangles.shape != after.triangles.shape:
        yield (
            f"has {len(before.points)} points and {len(before.triangles)} triangles before, "
            f"{len(after.points)} and {len(after.triangles)} after"
        )
        return
    order = _same_order(before.points, after.points)
    if order is None:
        yield "has points that are like no others"
        return
    yield from _number_differences(before.points, after.points[order], tolerance)
    number = np.empty(len(order), np.intp)
    number[order] = np.arange(len(order))
    if not np.array_equal(_sorted_triangles(before.triangles), _sorted_triangles(number[after.triangles])):
        yield "joins other points to triangles"


def _same_order(before: NDArray[Any], after: NDArray[Any]) -> NDArray[np.intp] | None:
    """The point of `after` that is most like each of `before`; None if that is one point for several."""
    order = np.asarray(cKDTree(after).query(before)[1], np.intp)
    return order if len(np.unique(order)) == len(order) else None


def _sorted_triangles(triangles: NDArray[Any]) -> NDArray[Any]:
    """Each from its smallest index on, in their order."""
    begin = np.argmin(triangles, axis=1)[:, None]
    turned = np.take_along_axis(triangles, (begin + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T[::-1])]


def _changes(before: Sequence[str], after: Sequence[str], between: str) -> Iterator[str]:
    """The parts of a text that changed."""
    begin = next((n for n, pair in enumerate(zip(before, after, strict=False)) if pair[0] != pair[1]), None)
    begin = min(len(before), len(after)) if begin is None else begin
    before, after = before[begin:], after[begin:]
    if max(len(before), len(after)) > _MOST_LINES:
        yield f"{_shown(between.join(before[:3]))} and what follows is now {_shown(between.join(after[:3]))}"
        return
    for kind, first, end, new, until in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        if kind != "equal":
            yield f"{_shown(between.join(before[first:end]))} is now {_shown(between.join(after[new:until]))}"
