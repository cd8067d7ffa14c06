"""Each mutation flips one operator, and changes nothing else."""

import ast
import runpy
from pathlib import Path
from typing import Any

from tests.support.places import ROOT

SOURCE = '''\
def reach(a: float, b: float, *more: float, **named: float) -> str:
    """Signs in texts + comments - stay; µ is two bytes."""
    total = (a  # a + b
             + b) * -a
    total /= 2.0
    if 0 < total <= b and a == b:
        total -= sum(more)
    return "at " + f"{total}"
'''


def mutants_of(path: Path) -> list[Any]:
    return list(runpy.run_path(str(ROOT / "tools/mutate.py"))["mutants_of"](path))


def test_every_arithmetic_operator_is_flipped_once(tmp_path: Path) -> None:
    path = tmp_path / "reach.py"
    path.write_text(SOURCE, encoding="utf-8")
    before = path.read_bytes()
    flips = []
    for mutant in mutants_of(path):
        after = mutant.applied(before)
        ast.parse(after)
        assert after[: mutant.start] == before[: mutant.start]
        assert after[mutant.start + len(mutant.text) :] == before[mutant.end :]
        flips.append((mutant.line, before[mutant.start : mutant.end].decode(), mutant.text.decode()))
    assert sorted(flips) == [
        (4, "*", "/"),
        (4, "+", "-"),
        (4, "-", "+"),
        (5, "/", "*"),
        (6, "<", ">="),
        (6, "<=", ">"),
        (7, "-", "+"),
    ]
