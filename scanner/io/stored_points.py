"""Points of clouds as other programs store them, a few million of which are kept: XYZ and PTS, PLY, PCD.

PCD by https://pointclouds.org/documentation/tutorials/pcd_file_format.html; PLY by Turk (1994).
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io.given_file import opened
from scanner.io.text_rows import read_text_rows, table_layout, text_layout

MOST_POINTS = 2_000_000  # of a cloud, spread evenly over the file, that are kept
_LONGEST_HEADER = 1 << 16
_POINTS_AT_ONCE = 1 << 20
_XYZ = ("x", "y", "z")
_NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
_END_OF_PLY = re.compile(rb"end_header[ \t]*(\r\n|\n|\r)")
_DATA_OF_PCD = re.compile(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", re.MULTILINE)
_WHOLE_NUMBER = re.compile(r"[0-9]{1,12}")
_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """Points of a cloud as its file has them, numbers or not."""

    points: Floats
    """(N, 3)"""
    normals: Floats | None
    """(N, 3), of any length; None where the file has none."""
    total: int
    """Points of the file, from which these were taken."""
    unreadable: int
    """Lines without coordinates, among those that were read."""


@dataclass(frozen=True, eq=False)
class PlyHeader:
    """What a PLY file says that it holds."""

    byte_order: str
    """As NumPy has it; '' for text."""
    elements: dict[str, int]
    """How many there are of each kind, in the file's order."""
    vertex: np.dtype[np.void] | None
    """Of a vertex, if the file begins with vertices that are all of one size."""
    newline: bytes
    start: int
    """Byte after the header."""


def points_of_text(path: Path) -> StoredPoints:
    """Of XYZ, or PTS. Raises InputError if it holds something else, or fewer points than it says."""
    layout = text_layout(path)
    columns = dict(layout.columns)
    if path.suffix.lower() == ".xyzn":
        columns |= {name: columns["z"] + 1 + k for k, name in enumerate(_NORMALS[0])}
    rows = read_text_rows(path, layout, [columns[name] for name in _names_in(path, columns)], MOST_POINTS)
    promised = layout.header[-1] if layout.header else ""
    if _WHOLE_NUMBER.fullmatch(promised) and rows.total < int(promised):
        raise _truncated(path, int(promised), rows.total)
    return _split(rows.values, rows.total, rows.unreadable)


def ply_header(path: Path) -> PlyHeader:
    """Read a header. Raises InputError if there is none, or if it is damaged."""
    with opened(path) as file:
        start = file.read(_LONGEST_HEADER)
    end = _END_OF_PLY.search(start)
    if not re.match(rb"ply[ \t]*[\r\n]", start):
        raise InputError(f"{path}: expected a PLY file, which begins with 'ply', found something else")
    if end is None:
        raise InputError(f"{path}: expected a PLY file, found one whose header does not end: copy the file again")
    lines = [line.split() for line in start[: end.start()].decode("ascii", errors="replace").splitlines()]
    formats = [line[1] for line in lines if len(line) == 3 and line[0] == "format"]
    elements: dict[str, int] = {}
    vertex: list[tuple[str, str]] | None = []
    for line in lines:
        if line[:1] == ["element"] and len(line) == 3 and _WHOLE_NUMBER.fullmatch(line[2]):
            elements[line[1]] = int(line[2])
        elif line[:1] == ["property"] and list(elements) == ["vertex"] and vertex is not None:
            vertex = [*vertex, (line[2], line[1])] if len(line) == 3 and line[1] in _PLY_TYPES else None
    if not formats or formats[0] not in _BYTE_ORDERS or "vertex" not in elements:
        raise InputError(f"{path}: expected a PLY file with vertices, found a header without them, or a damaged one")
    order = _BYTE_ORDERS[formats[0]]
    fields = [(name, order + _PLY_TYPES[kind]) for name, kind in vertex or []]
    kind = np.dtype(fields) if len({name for name, _ in fields}) == len(fields) > 0 else None
    return PlyHeader(order, elements, kind, end[1], end.end())


def points_of_ply(path: Path, header: PlyHeader) -> StoredPoints:
    """The vertices, for a header with their type. Raises InputError if they have no coordinates, or if the file is
    truncated.
    """
    assert header.vertex is not None
    count = header.elements["vertex"]
    if header.byte_order:
        return _of_bytes(path, header.vertex, count, header.start)
    columns = {name: k for k, name in enumerate(header.vertex.names or ())}
    return _of_lines(path, columns, count, header.start, header.newline)


def points_of_pcd(path: Path) -> StoredPoints | None:
    """Of PCD as text; None of a binary one. Raises InputError without coordinates, or if it is truncated."""
    with opened(path) as file:
        start = file.read(_LONGEST_HEADER)
    data = _DATA_OF_PCD.search(start)
    if data is None:
        raise InputError(f"{path}: expected a cloud as PCD, found something else, or a damaged header")
    lines = [line.split() for line in start[: data.end()].decode("ascii", errors="replace").splitlines()]
    keys = {line[0]: line[1:] for line in lines if line}
    if keys["DATA"] != ["ascii"]:
        return None
    names, points = keys.get("FIELDS", []), keys.get("POINTS", [])
    counts = keys.get("COUNT", ["1"] * len(names))
    if len(counts) != len(names) or len(points) != 1 or not all(map(_WHOLE_NUMBER.fullmatch, [*counts, *points])):
        raise InputError(f"{path}: expected a cloud as PCD, found a damaged header")
    firsts = np.cumsum([0, *map(int, counts)])
    columns = {name: int(first) for name, first in zip(names, firsts[:-1], strict=True)}
    return _of_lines(path, columns, int(points[0]), data.end(), b"\n")


def _of_lines(path: Path, columns: dict[str, int], count: int, start: int, newline: bytes) -> StoredPoints:
    """Of `count` lines from a byte on."""
    names = _names_in(path, columns)
    layout = table_layout(columns, newline, start)
    rows = read_text_rows(path, layout, [columns[name] for name in names], MOST_POINTS, count)
    if rows.total < count:
        raise _truncated(path, count, rows.total)
    return _split(rows.values, count, rows.unreadable)


def _of_bytes(path: Path, kind: np.dtype[np.void], count: int, start: int) -> StoredPoints:
    """Of `count` records from a byte on."""
    names = _names_in(path, kind.names or ())
    step = max(1, -(-count // MOST_POINTS))
    parts = [np.zeros((0, len(names)))]
    with opened(path) as file:
        size = file.seek(0, 2) - start
        if size < count * kind.itemsize:
            raise _truncated(path, count, max(0, size) // kind.itemsize)
        file.seek(start)
        for first in range(0, count, _POINTS_AT_ONCE):
            some = min(_POINTS_AT_ONCE, count - first)
            records = np.frombuffer(file.read(some * kind.itemsize), kind)[-first % step :: step]
            parts.append(np.stack([records[name].astype(np.float64) for name in names], axis=1))
    return _split(np.concatenate(parts), count, 0)


def _names_in(path: Path, given: Iterable[str]) -> tuple[str, ...]:
    """Names of coordinates and, where there are any, of normals. Raises InputError without coordinates."""
    given = tuple(given)
    if not set(_XYZ) <= set(given):
        raise InputError(f"{path}: expected points with x, y and z, found {', '.join(given) or 'none of them'}")
    return next(((*_XYZ, *names) for names in _NORMALS if set(names) <= set(given)), _XYZ)


def _split(values: Floats, total: int, unreadable: int) -> StoredPoints:
    return StoredPoints(values[:, :3], values[:, 3:] if values.shape[1] > 3 else None, total, unreadable)


def _truncated(path: Path, promised: int, actual: int) -> InputError:
    there = f"its header promises {promised:,} points, and {actual:,} are there"
    return InputError(f"{path}: is truncated: {there}: copy it again")
