"""Mutations of files: bytes, YAML text and values, tables, numbers."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import yaml

Random = np.random.Generator

_INTERESTING = (0, 1, 0x7F, 0x80, 0xFF)
_NUMBERS = (0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**32 - 1)
_SNIPPETS = (
    "&a [*a]", "&a {<<: *a}", "[" * 200, "{a: " * 50, "!!bool x", "!!int ''", "!!int 1:2:3", "!!float x", "!!binary é",
    "!!python/object:os.system x", "!<%1b[31m> x", "2024-13-45", "1:1:1:1:1:1", "9" * 5000, "0x" + "f" * 5000,
    "1e999", "\"\\e[31m\"", "\"\\x00\"", "\"\\u202e\"", "? [a]: b", "? {}", "- " * 100, "%YAML 9.9\n---", "*x",
    "&x x\n*x : y", "!!set {a, b}", "!!omap [a: b]", "!!timestamp x", "<<: [1, 2]", "|\n a", "\t", "\ufeff",
    "{", "]", "---\na: 1\n---\n",
)  # fmt: skip
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**53, -(2**63), 10**30, 0.0, -0.0, 1e308, -1e308, 1e-320, 1e9, float("inf"),
    float("nan"), 65535, 65536, 30000, "", "x" * 3000, "\x1b[31m", "[/red]", "../../etc/passwd", "/dev/zero", "a\0b",
    [], {}, [[]], [1], [1, 2], [1, 2, 3], ["a"] * 300, {"kind": "phase"}, {"a": {"b": {"c": [1]}}}, "é" * 70, "1",
)  # fmt: skip
_CELLS = (
    "", " ", ".", "..", "../x", "/x", "x/", "x//y", "./x", "~", "a", "b", "room.yaml", "known.yaml", "name", "capture",
    "x" * 300, "x" * 200_000, "x/" * 3000, "\x00", "a\0b", "\x1b[31m", "\u202e", "\n", '"', ",", ";", "é" * 200, "*",
    "[a", "memory://x", "nothing://x", "://", "zip://a::b", "file:///dev/zero", "/dev/zero", "/etc/passwd", "method",
    "method=", "=", "a.b.c=1", "method=[[[", "corner=1", "scale.baseline_m=1e999", "rig.backend=x",
)  # fmt: skip


def of_bytes(data: bytes, rng: Random) -> bytes:
    """Some bytes flipped, overwritten, removed, inserted, repeated or cut off."""
    changed = bytearray(data)
    for _ in range(1 + int(rng.geometric(0.5))):
        if not changed:
            return bytes(changed)
        at, length = int(rng.integers(len(changed))), min(1 << int(rng.integers(8)), len(changed))
        match int(rng.integers(8)):
            case 0 | 1:
                changed[at] ^= 1 << int(rng.integers(8))
            case 2:
                changed[at] = _INTERESTING[int(rng.integers(len(_INTERESTING)))]
            case 3:
                number = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
                changed[at : at + 4] = number.to_bytes(4, "big" if rng.random() < 0.5 else "little")
            case 4:
                del changed[at : at + length]
            case 5:
                changed[at:at] = rng.bytes(length)
            case 6:
                changed[at:at] = changed[at : at + length]
            case _:
                del changed[at:]
    return bytes(changed)


def of_header(data: bytes, rng: Random) -> bytes:
    """The same, half of the time among the first hundred bytes, where sizes are."""
    cut = min(100, len(data))
    return of_bytes(data[:cut], rng) + data[cut:] if rng.random() < 0.5 else of_bytes(data, rng)


def of_yaml(value: Any, rng: Random) -> bytes:
    """YAML text of a value with parts replaced, or with its text changed."""
    for _ in range(int(rng.integers(4))):
        value = _of_value(value, rng)
    text = yaml.dump(value, Dumper=yaml.CSafeDumper, allow_unicode=True, sort_keys=False)
    kind = rng.random()
    if kind < 0.3:
        places = [index for index, letter in enumerate(text) if letter in ":,[\n"]
        at = places[int(rng.integers(len(places)))] + 1 if places else 0
        snippet = _SNIPPETS[int(rng.integers(len(_SNIPPETS)))]
        text = f"{text[:at]} {snippet} {text[at:]}"
    data = text.encode("utf-8", errors="replace")
    return of_bytes(data, rng) if kind > 0.8 else data


def _of_value(value: Any, rng: Random) -> Any:
    """One nested value replaced, removed, doubled or scaled."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        keys = list(value)
        key = keys[int(rng.integers(len(keys)))]
        match int(rng.integers(10)):
            case 0:
                return {name: inner for name, inner in value.items() if name != key}
            case 1:
                return {**value, f"{key}{int(rng.integers(9))}": value[key]}
            case _:
                return {**value, key: _of_value(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.9:
        at = int(rng.integers(len(value)))
        match int(rng.integers(10)):
            case 0:
                return value[:at] + value[at + 1 :]
            case 1:
                return value[:at] + value[at : at + 1] * int(rng.integers(2, 40)) + value[at + 1 :]
            case _:
                return [*value[:at], _of_value(value[at], rng), *value[at + 1 :]]
    if isinstance(value, float | int) and rng.random() < 0.5:
        return extreme(float(value), rng)
    return _VALUES[int(rng.integers(len(_VALUES)))]


def of_csv(rows: Sequence[Mapping[str, str]], rng: Random) -> bytes:
    """A table of `rows`, with cells replaced, removed and inserted."""
    table = [[*rows[0]], *([*row.values()] for row in rows)]
    for _ in range(int(rng.integers(4))):
        line = table[int(rng.integers(len(table)))]
        at = int(rng.integers(len(line) + 1))
        line[at : at + int(rng.integers(3))] = [_CELLS[int(rng.integers(len(_CELLS)))]] * int(rng.integers(3))
    text = io.StringIO()
    csv.writer(text).writerows(table)
    data = text.getvalue().encode("utf-8", errors="replace")
    return of_bytes(data, rng) if rng.random() < 0.3 else data


def extreme(value: float, rng: Random) -> float:
    """A number that is close, of another magnitude, or of the other sign."""
    factor = 10.0 ** float(rng.choice([0.01, 1, 3, 8, 50])) if rng.random() < 0.7 else 1.0
    changed = float(value * factor if rng.random() < 0.5 else value / factor)
    return -changed if rng.random() < 0.2 else changed


Mutation = Callable[[bytes, Random], bytes]
