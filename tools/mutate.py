"""Flip operators one at a time and see whether a test notices: what survives has no test, or is not needed.

    python tools/mutate.py --record                      # which test runs what; kept, and continued if interrupted
    python tools/mutate.py --count 200 --seed 1          # anywhere in calib/, hw/ and scanner/
    python tools/mutate.py --at calib/plane_segmentation/faces.py:60 --at scanner/decoding/light/samples.py:40

Works in a temporary copy of the tree. The tests of a line are those that run it, as recorded, up to --seconds of them,
the nearest and the fastest first, and the folder that mirrors the file's own if none of them is there; or --tests.
"""

import ast
import os
import random
import re
import shutil
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))
from tools.called_functions import RECORD_FILE
from tools.covering_tests import PRODUCT, ROOT, CoveringTests

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


def outcome_of(mutant: Mutant, copy: Path, tests: list[str], time_limit_s: float) -> str:
    """What the tests say of it: "noticed", also if they cannot even be collected, "SURVIVED", or "endless": they were
    still running at the limit, because of it or of the machine.
    """
    file = copy / mutant.path
    source = file.read_bytes()
    # The machine code that Numba keeps is renewed with its file; Python's own is not written at all.
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    try:
        file.write_bytes(mutant.applied(source))
        run = subprocess.run(command, cwd=copy, env=environment, timeout=time_limit_s, capture_output=True)
    except subprocess.TimeoutExpired:
        return "endless"
    finally:
        file.write_bytes(source)
    if run.returncode not in (0, 1, 2, 4):
        raise SystemExit(f"{mutant}\n{run.stdout.decode()}{run.stderr.decode()}")
    return "noticed" if run.returncode else "SURVIVED"


def tests_of(mutant: Mutant, covering: CoveringTests, most_s: float) -> list[str]:
    """The tests that run its line; and if none of them is in the folder that mirrors its own, or in the nearest above
    that there is, that folder.
    """
    folder = mutant.path.parent
    while not (ROOT / "tests" / folder).is_dir():
        folder = folder.parent
    mirror = f"tests/{folder.as_posix()}/"
    chosen, total_s = list[str](), 0.0
    for test in covering.of_line(mutant.path, mutant.line):
        total_s += covering.seconds[test]
        if chosen and total_s > most_s:
            break
        chosen.append(test)
    return chosen if any(test.startswith(mirror) for test in chosen) else [mirror, *chosen]


def main() -> int:
    """Print survivors; exit code 1 if more than a tenth."""
    options = _options()
    if options.record:
        plugin = [sys.executable, "-m", "pytest", "-p", "tools.called_functions", *(options.tests or ["tests"])]
        return subprocess.run(plugin, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}).returncode
    mutants, covering = _chosen(options), CoveringTests(RECORD_FILE)
    outcomes = Counter[str]()
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "tree"
        for name in _COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("*.pyc"))
            else:
                shutil.copy2(ROOT / name, copy / name)
        for number, mutant in enumerate(mutants, 1):
            tests = options.tests or tests_of(mutant, covering, options.seconds)
            outcome = outcome_of(mutant, copy, tests, options.time_limit)
            outcomes[outcome] += 1
            print(f"{number}/{len(mutants)} {outcome} ({len(tests)}): {mutant}", flush=True)
    print(", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common()))
    return int(outcomes["SURVIVED"] > len(mutants) / 10)


def _chosen(options: Namespace) -> list[Mutant]:
    if options.at:
        places = [place.rsplit(":", 1) for place in options.at]
        return [mutant for path, line in places for mutant in mutants_of(Path(path)) if mutant.line == int(line)]
    folders = options.folder or PRODUCT
    paths = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    mutants = [mutant for path in paths for mutant in mutants_of(path.relative_to(ROOT))]
    return random.Random(options.seed).sample(mutants, options.count)


def _options() -> Namespace:
    assert __doc__ is not None
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40, help="operators to flip (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the choice (default: %(default)s)")
    parser.add_argument(
        "--folder", action="append", metavar="PATH", help=f"to choose from (default: {', '.join(PRODUCT)})"
    )
    parser.add_argument("--at", action="append", metavar="FILE:LINE", help="all operators of a line instead")
    parser.add_argument("--tests", action="append", default=[], metavar="PATH", help="to run, or to record, instead")
    parser.add_argument("--record", action="store_true", help="run the tests and record which functions each calls")
    parser.add_argument(
        "--seconds", type=float, default=120.0, help="of tests for each operator (default: %(default)s)"
    )
    parser.add_argument("--time-limit", type=float, default=600.0, metavar="SECONDS", help="for each run of tests")
    return parser.parse_args()


if __name__ == "__main__":
    raise SystemExit(main())
