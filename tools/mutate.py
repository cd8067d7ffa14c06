"""Flip operators one at a time and see whether a test notices: what survives has no test, or is not needed.

    python tools/mutate.py --count 20 --seed 1           # anywhere in calib/ and scanner/decoding/
    python tools/mutate.py --at calib/plane_segmentation/faces.py:60 --at scanner/decoding/samples.py:40

Works in a temporary copy of the tree. The tests of a file are those in the folder that mirrors its own, or --tests.
"""

import ast
import os
import random
import re
import shutil
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
_FOLDERS = ("calib", "scanner/decoding")
_COPIED = ("benchmarks", "calib", "configs", "docs", "hw", "scanner", "tests", "tools", "pyproject.toml")
_FLIPPED: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Lt: ("<", ">="),
    ast.GtE: (">=", "<"),
    ast.Gt: (">", "<="),
    ast.LtE: ("<=", ">"),
    ast.USub: ("-", "+"),
}


@dataclass(frozen=True)
class Mutant:
    """An operator of a file: the bytes [start, end) of its source become `text`."""

    path: Path
    line: int
    start: int
    end: int
    text: bytes

    def applied(self, source: bytes) -> bytes:
        """The source with the operator flipped."""
        return source[: self.start] + self.text + source[self.end :]

    def __str__(self) -> str:
        source = (ROOT / self.path).read_bytes()
        line = source.splitlines()[self.line - 1].decode().strip()
        return f"{self.path}:{self.line}: {source[self.start : self.end].decode()} → {self.text.decode()}: {line}"


def mutants_of(path: Path) -> list[Mutant]:
    """Of a file under the repository."""
    source = (ROOT / path).read_bytes()
    lengths = [len(line) for line in source.splitlines(keepends=True)]
    starts = [sum(lengths[:number]) for number in range(len(lengths))]
    found = []
    for node, begin, end in _operators(ast.parse(source), starts):
        old, new = _FLIPPED.get(type(node), ("", ""))
        between = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment[0]), source[begin:end])
        if old:
            place = begin + between.index(old.encode())
            found.append(Mutant(path, source.count(b"\n", 0, place) + 1, place, place + len(old), new.encode()))
    return found


def _operators(tree: ast.Module, starts: list[int]) -> Iterator[tuple[ast.AST, int, int]]:
    """Operators between two numbers, each with the range of bytes in which it is written."""

    def before(node: ast.expr) -> int:
        return starts[node.lineno - 1] + node.col_offset

    def after(node: ast.expr) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return starts[node.end_lineno - 1] + node.end_col_offset

    for node in ast.walk(tree):
        match node:
            case ast.BinOp(left, operator, right) if not _is_text(left) and not _is_text(right):
                yield operator, after(left), before(right)
            case ast.AugAssign(ast.Name() | ast.Subscript() | ast.Attribute() as target, operator, value):
                yield operator, after(target), before(value)
            case ast.Compare(left, operators, others):
                for comparison, one, other in zip(operators, [left, *others], others, strict=False):
                    yield comparison, after(one), before(other)
            case ast.UnaryOp(ast.USub() as minus, operand):
                yield minus, before(node), before(operand)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def survives(mutant: Mutant, copy: Path, tests: list[str], time_limit_s: float) -> bool:
    """Whether the tests pass with it; a test that never ends has noticed."""
    file = copy / mutant.path
    source = file.read_bytes()
    # The machine code that Numba keeps is renewed with its file; Python's own is not written at all.
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "-p",
        "no:cacheprovider",
        *(tests or [_tests_of(mutant.path)]),
    ]
    try:
        file.write_bytes(mutant.applied(source))
        run = subprocess.run(command, cwd=copy, env=environment, timeout=time_limit_s, capture_output=True)
    except subprocess.TimeoutExpired:
        return False
    finally:
        file.write_bytes(source)
    if run.returncode not in (0, 1):
        raise SystemExit(f"{mutant}\n{run.stdout.decode()}{run.stderr.decode()}")
    return run.returncode == 0


def _tests_of(path: Path) -> str:
    """The folder that mirrors the file's own, or the nearest above that there is."""
    folder = path.parent
    while not (ROOT / "tests" / folder).is_dir():
        folder = folder.parent
    return str("tests" / folder)


def main() -> int:
    """Print survivors; exit code 1 if more than a tenth."""
    options = _options()
    mutants = _chosen(options)
    survivors = 0
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "tree"
        for name in _COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("*.pyc"))
            else:
                shutil.copy2(ROOT / name, copy / name)
        for number, mutant in enumerate(mutants, 1):
            survived = survives(mutant, copy, options.tests, options.time_limit)
            survivors += survived
            print(f"{number}/{len(mutants)} {'SURVIVED' if survived else 'noticed '} {mutant}", flush=True)
    print(f"{len(mutants) - survivors} of {len(mutants)} noticed")
    return int(survivors > len(mutants) / 10)


def _chosen(options: Namespace) -> list[Mutant]:
    if options.at:
        places = [place.rsplit(":", 1) for place in options.at]
        return [mutant for path, line in places for mutant in mutants_of(Path(path)) if mutant.line == int(line)]
    folders = options.folder or _FOLDERS
    paths = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    mutants = [mutant for path in paths for mutant in mutants_of(path.relative_to(ROOT))]
    return random.Random(options.seed).sample(mutants, options.count)


def _options() -> Namespace:
    assert __doc__ is not None
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40, help="operators to flip (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the choice (default: %(default)s)")
    parser.add_argument(
        "--folder", action="append", metavar="PATH", help=f"to choose from (default: {', '.join(_FOLDERS)})"
    )
    parser.add_argument("--at", action="append", metavar="FILE:LINE", help="all operators of a line instead")
    parser.add_argument("--tests", action="append", default=[], metavar="PATH", help="to run instead of the folder's")
    parser.add_argument("--time-limit", type=float, default=600.0, metavar="SECONDS", help="for each run of tests")
    return parser.parse_args()


if __name__ == "__main__":
    raise SystemExit(main())
