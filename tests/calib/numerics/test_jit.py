"""Compiled functions give NumPy's results, also in threads, and are recompiled when their source changes."""

import ast
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numba.core import config

from calib.numerics import Floats, in_pieces
from calib.numerics.jit import compiled, when_compiling
from calib.numerics.machine_code import _sources
from calib.refinement.reprojection_jacobians import reproject
from tests.support.places import ROOT

SOURCES = sorted(path for package in ("calib", "hw", "scanner") for path in (ROOT / package).rglob("*.py"))
# What never changes together with this repository.
LASTING = {"numpy", "math"}


@compiled
def ratios(numerator: Floats, denominator: Floats, found: Floats) -> None:
    """Elementwise ratios (N,)."""
    for i in range(len(numerator)):
        found[i] = numerator[i] / denominator[i]


NUMBERS = arrays.arrays(np.float64, 20, elements=st.floats(allow_nan=True, allow_infinity=True, width=64))


@given(NUMBERS, NUMBERS)
def test_division_follows_numpy(numerator: Floats, denominator: Floats) -> None:
    found = np.empty(20)
    ratios(numerator, denominator, found)
    with np.errstate(all="ignore"):
        expected = numerator / denominator
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_threads_share_the_work() -> None:
    count = 1 << 18
    numerator, denominator, found = np.arange(1.0, count + 1), np.arange(2.0, count + 2), np.zeros(count)
    in_pieces(count, lambda at: ratios(numerator[at], denominator[at], found[at]))
    np.testing.assert_allclose(found, numerator / denominator, rtol=1e-15)


def borrowed(source: str) -> list[str]:
    """Names that compiled functions of a source file import from another file that may change, except types."""
    tree = ast.parse(source)
    imported = {
        alias.asname or alias.name
        for node in tree.body
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
        if (node.module if isinstance(node, ast.ImportFrom) else alias.name) not in LASTING
    }
    found = []
    for function in ast.walk(tree):
        decorators = getattr(function, "decorator_list", [])
        if any(isinstance(decorator, ast.Name) and decorator.id in ("compiled", "inlined") for decorator in decorators):
            body = [node for statement in function.body for node in ast.walk(statement)]  # type: ignore[attr-defined]
            types = {id(node.annotation) for node in body if isinstance(node, ast.AnnAssign)}
            body = [node for node in body if id(node) not in types]
            found += [node.id for node in body if isinstance(node, ast.Name) and node.id in imported]
    return found


def test_compiled_functions_use_their_own_file_and_compiled_functions_of_others() -> None:
    found = {path: borrowed(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert len(found) > 100
    for path, names in found.items():
        if names:
            module = import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
            assert [name for name in names if not hasattr(getattr(module, name), "py_func")] == [], path


def test_machine_code_follows_the_compiled_functions_that_it_calls() -> None:
    files = [path.name for path in _sources(reproject.py_func)]  # type: ignore[attr-defined]
    assert files[0] == "reprojection_jacobians.py"
    assert {"radial_distortion.py"} <= set(files)


def test_an_imported_constant_is_found() -> None:
    source = (
        "from calib.geometry.radial_distortion import STEP\n"
        "import numpy as np\n@compiled\ndef f(x):\n    return STEP * np.sin(x)\n"
    )
    assert borrowed(source) == ["STEP"]


def test_compiling_is_announced_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    told: list[str] = []
    when_compiling(lambda: told.append("compiling"))
    for _ in range(2):
        compiled(lambda number: number + 1)(1)
    assert told == ["compiling"]
