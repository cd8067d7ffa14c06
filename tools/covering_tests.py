"""Which tests run a line of the product, by what `tools/called_functions.py` has recorded.

Machine code is run by whoever calls it: of a compiled function, and of a constant, those are the functions
that name it.
"""

import ast
import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PRODUCT = ("calib", "hw", "scanner")
_COMPILED = {"compiled", "inlined"}


@dataclass(frozen=True)
class SourceFunction:
    """A function of the product."""

    # From the repository's root, with slashes.
    path: str
    # Qualified, as Python writes it.
    name: str
    first_line: int
    last_line: int
    is_compiled: bool
    # All names that it mentions.
    mentioned: frozenset[str]

    @property
    def key(self) -> str:
        """As it is recorded."""
        return f"{self.path}:{self.name}"


@dataclass(frozen=True)
class CoveringTests:
    """The tests of a record file, with their times in seconds and the functions that they call."""

    record: Path

    def of_line(self, path: Path, line: int) -> list[str]:
        """The names of tests that run a line: those of the folder that mirrors its own first, then the fastest."""
        tests = {test for key in self._keys(path.as_posix(), line) for test in self._by_function[key]}
        mirror = f"tests/{path.parent.as_posix()}/"
        return sorted(tests, key=lambda test: (not test.startswith(mirror), self.seconds[test], test))

    @cached_property
    def seconds(self) -> dict[str, float]:
        """Of each test."""
        return {entry["test"]: entry["seconds"] for entry in self._entries}

    @cached_property
    def _entries(self) -> list[dict[str, Any]]:
        if not self.record.is_file():
            return []
        return [json.loads(line) for line in self.record.read_text(encoding="utf-8").splitlines()]

    @cached_property
    def _by_function(self) -> dict[str, set[str]]:
        tests = defaultdict[str, set[str]](set)
        for entry in self._entries:
            for function in entry["functions"]:
                tests[function].add(entry["test"])
        return tests

    def _keys(self, path: str, line: int) -> set[str]:
        here = [function for function in _functions_of_product() if function.path == path]
        around = [function for function in here if function.first_line <= line <= function.last_line]
        if around:
            innermost = max(around, key=lambda function: function.first_line)
            return self._callers(innermost) if innermost.is_compiled else {innermost.key}
        constants = _assigned_at(ROOT / path, line)
        keys = {key for name in constants for key in self._naming(name, path, set())}
        return keys or {function.key for function in here}

    def _callers(self, function: SourceFunction, known: set[str] | None = None) -> set[str]:
        return self._naming(function.name.rsplit(".", 1)[-1], function.path, known or {function.key})

    def _naming(self, name: str, path: str, known: set[str]) -> set[str]:
        """Functions that name something of a file and that Python runs; private names belong to their file."""
        keys = set[str]()
        for function in _functions_of_product():
            if name in function.mentioned and function.key not in known and (function.path == path or name[0] != "_"):
                known.add(function.key)
                keys |= self._callers(function, known) if function.is_compiled else {function.key}
        return keys


@cache  # of hundreds of files
def _functions_of_product() -> tuple[SourceFunction, ...]:
    paths = sorted(path for folder in PRODUCT for path in (ROOT / folder).rglob("*.py"))
    return tuple(function for path in paths for function in functions_of(path))


def functions_of(path: Path) -> list[SourceFunction]:
    """Of a file of the repository, the nested ones too."""
    tree = ast.parse(path.read_bytes())
    return list(_functions_in(tree, path.relative_to(ROOT).as_posix(), ""))


def _functions_in(node: ast.AST, path: str, prefix: str) -> Iterator[SourceFunction]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            decorators = {name.id for name in child.decorator_list if isinstance(name, ast.Name)}
            first = min([child.lineno, *(decorator.lineno for decorator in child.decorator_list)])
            last = child.end_lineno or child.lineno
            is_compiled = bool(decorators & _COMPILED)
            yield SourceFunction(path, prefix + child.name, first, last, is_compiled, frozenset(_names(child)))
            yield from _functions_in(child, path, f"{prefix}{child.name}.<locals>.")
        elif isinstance(child, ast.ClassDef):
            yield from _functions_in(child, path, f"{prefix}{child.name}.")
        else:
            yield from _functions_in(child, path, prefix)


def _names(node: ast.AST) -> Iterator[str]:
    for child in ast.walk(node):
        if isinstance(child, ast.Name):
            yield child.id
        elif isinstance(child, ast.Attribute):
            yield child.attr


def _assigned_at(path: Path, line: int) -> list[str]:
    """Names that a statement of a module, which reaches over that line, gives values."""
    for statement in ast.parse(path.read_bytes()).body:
        if statement.lineno <= line <= (statement.end_lineno or statement.lineno):
            targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
            return [name for target in targets if target is not None for name in _names(target)]
    return []
