"""Numbers in the lines of a text file, as of clouds in XYZ, PTS, ASCII PLY and PCD. Of a large file, lines that are
spread evenly over it are read.

Blanks, tabs, semicolons or commas are between the numbers, which may have decimal commas. Lines before the first one
with three numbers are a header, which may name the columns.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io.given_file import opened
from scanner.shown_text import shown

_PIECE = 1 << 25  # bytes at a time
_BEGINNING = 1 << 16  # bytes that tell what a file is like
_SAMPLE, _FEWEST_NUMBERED = 200, 20  # lines of it; and those that tell that a first column numbers the points
_MOST_UNREADABLE = 0.5  # share of the lines, beyond which a file holds something else
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
_WITH_DECIMAL_COMMAS, _WITHOUT = bytes.maketrans(b",;", b". "), bytes.maketrans(b",;", b"  ")
_REMARKS = (b"#", b"/", b"%", b"!")
_NOT_IN_NAMES = "#/%!\"'"
_UTF_8, _UTF_16 = b"\xef\xbb\xbf", (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, eq=False)
class TextRows:
    """Numbers of some lines."""

    values: Floats
    """(N, C): of the columns that were asked for."""
    total: int
    """Lines of numbers, or of remarks, in the file."""
    unreadable: int
    """Lines that were read, but do not have these numbers."""


@dataclass(frozen=True)
class TextLayout:
    """How a text file of points is written."""

    header: tuple[str, ...]
    """Lines before the first one with three numbers."""
    columns: dict[str, int]
    """Numbers of the columns x, y and z, and of others that the header names, in small letters."""
    separators: bytes
    """Replacements of all characters, after which blanks separate numbers."""
    newline: bytes
    start: int
    """Byte at which the numbers begin."""


def text_layout(path: Path) -> TextLayout:
    """How the points of a file are written, from its beginning. Raises InputError if it has no line with three
    numbers.
    """
    with opened(path) as file:
        beginning = file.read(_BEGINNING)
    if beginning.startswith(_UTF_16):
        raise InputError(f"{path}: is text in UTF-16: save it in UTF-8 or ASCII")
    newline = b"\n" if b"\n" in beginning else b"\r"
    mark = len(_UTF_8) if beginning.startswith(_UTF_8) else 0
    lines = beginning[mark:].split(newline)
    if len(beginning) == _BEGINNING:
        lines = lines[:-1]  # it goes on
    separators = _WITH_DECIMAL_COMMAS if _has_decimal_commas(lines) else _WITHOUT
    numbers = [_numbers(line.translate(separators)) for line in lines]
    start = next((k for k, of_line in enumerate(numbers) if len(of_line) >= 3), None)
    if start is None:
        first = next((line for line in lines if line.strip()), b"").decode("utf-8", errors="replace")
        raise InputError(f"{path}: expected lines with three numbers, x y z, or more, found {shown(first.strip())}")
    sample = [of_line for of_line in numbers[start : start + _SAMPLE] if len(of_line) >= 3]
    header = tuple(line.decode("utf-8", errors="replace").strip() for line in lines[:start])
    named = _named(header, len(lines[start].translate(separators).split()))
    columns = named or dict(zip("xyz", count(1 if _are_numbered(sample) else 0), strict=False))
    return TextLayout(header, columns, separators, newline, mark + sum(len(line) + 1 for line in lines[:start]))


def table_layout(columns: dict[str, int], newline: bytes, start: int) -> TextLayout:
    """The same of a file whose own header tells it: blanks are between numbers."""
    return TextLayout((), columns, bytes.maketrans(b"", b""), newline, start)


def _has_decimal_commas(lines: list[bytes]) -> bool:
    """Whether commas are within numbers, as in '0,5 1,25 −3,0', and not between them."""
    words = [line.translate(bytes.maketrans(b";", b" ")).decode("ascii", errors="replace").split() for line in lines]
    of_numbers = [of_line for of_line in words if len(of_line) >= 3 and all(word[-1].isdigit() for word in of_line)]
    with_commas = [word for of_line in of_numbers for word in of_line if "," in word]
    return len(with_commas) > 0 and all(_DECIMAL_COMMA.fullmatch(word) for word in with_commas)


def _numbers(line: bytes) -> list[float]:
    """The numbers that a line begins with, until something else comes."""
    numbers = []
    for word in line.split():
        try:
            numbers.append(float(word))
        except ValueError:
            break
    return numbers


def _named(header: Sequence[str], count: int) -> dict[str, int]:
    """Numbers of the columns by the names in the last line of a header; empty unless it names all, and x, y and z."""
    words = header[-1].lstrip(_NOT_IN_NAMES).lower() if header else ""
    names = [name.strip(_NOT_IN_NAMES) for name in words.translate(str.maketrans(",;", "  ")).split()]
    are_names = len(names) == count == len(set(names)) and {"x", "y", "z"} <= set(names)
    return {name: k for k, name in enumerate(names)} if are_names else {}


def _are_numbered(sample: list[list[float]]) -> bool:
    """Whether lines begin with the points' numbers, from 0 or 1."""
    begins = [of_line[0] for of_line in sample]
    steps = np.arange(len(sample)) + (begins[0] if begins[0] in (0.0, 1.0) else np.nan)
    return len(sample) >= _FEWEST_NUMBERED and min(map(len, sample)) > 3 and bool(np.all(steps == begins))


def read_text_rows(
    path: Path, layout: TextLayout, columns: Sequence[int], most: int, expected: int | None = None
) -> TextRows:
    """The numbers in some columns of the lines of a file, `expected` of them or all; of at most `most` lines.

    Raises InputError if the file is missing, or if most of its lines do not have these numbers.
    """
    there = sum(len(lines) for lines in _pieces(path, layout.newline, layout.start))
    total = there if expected is None else min(there, expected)
    step = max(1, -(-total // most))
    parts, strange, read = [np.zeros((0, len(columns)))], list[bytes](), 0
    for lines in _pieces(path, layout.newline, layout.start):
        some = [line.translate(layout.separators) for line in lines[-read % step : total - read : step]]
        read += len(lines)
        values, wrong = _values(some, columns)
        parts.append(values)
        strange += wrong
        if read >= total:
            break
    values = np.concatenate(parts)
    if len(strange) > _MOST_UNREADABLE * (len(values) + len(strange)):
        first = strange[0].decode("utf-8", errors="replace").strip()
        raise InputError(f"{path}: expected {max(columns) + 1} numbers or more in a line, found {shown(first)}")
    return TextRows(values, total, len(strange))


def _pieces(path: Path, newline: bytes, start: int) -> Iterator[list[bytes]]:
    """The lines of a file, many at a time."""
    with opened(path) as file:
        file.seek(start)
        rest = b""
        while data := file.read(_PIECE):
            *lines, rest = (rest + data).split(newline)
            yield lines
        if rest.strip():
            yield [rest]


def _values(lines: list[bytes], columns: Sequence[int]) -> tuple[Floats, list[bytes]]:
    """Numbers (N, C) of lines, and those that do not have them; empty lines and remarks are neither."""
    lines = [line for line in lines if line.strip()]
    if not lines:
        return np.zeros((0, len(columns))), []
    try:
        return np.loadtxt(lines, comments=None, usecols=columns, ndmin=2), []
    except ValueError:
        rows, wrong = [], []
        for line in lines:
            words = line.split()
            try:
                rows.append([float(words[k]) for k in columns])
            except (ValueError, IndexError):
                wrong += [] if line.lstrip().startswith(_REMARKS) else [line]
        return np.array(rows, np.float64).reshape(-1, len(columns)), wrong
