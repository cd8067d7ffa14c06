"""Tests and benchmarks import what a folder offers, or the module that they are the tests of."""

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.support.places import ROOT

# Who may name the inside of another folder, and why.
ALLOWED = {
    ("benchmarks/cramer_rao.py", "calib.boards.likelihood"): "the bound is that of the model's own likelihood",
    ("benchmarks/cramer_rao.py", "calib.boards.parameters"): "the bound is that of the model's own parameters",
    ("benchmarks/cramer_rao.py", "calib.networks.prior"): "the bound is that of the model's own prior",
    (
        "tests/calib/numerics/test_jit.py",
        "calib.refinement.reprojection_jacobians",
    ): "a compiled loop that calls others",
    (
        "tests/scanner/decoding/test_sample_analysis.py",
        "scanner.decoding.light.frame_checks",
    ): "its own input",
}


def inside_of(module: str) -> str:
    """The folder that a module is inside of, such as calib.geometry; '' for a folder, and what is in none."""
    folder, _, name = module.rpartition(".")
    is_inside = folder.count(".") and (ROOT.joinpath(*folder.split(".")) / f"{name}.py").exists()
    return folder if is_inside and folder.split(".")[0] in ("calib", "hw", "scanner") else ""


def imported_by(path: Path) -> Iterator[str]:
    """The modules that a file imports names from."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def test_no_file_imports_the_inside_of_a_folder_that_it_does_not_test() -> None:
    offences = set()
    for path in (file for folder in ("tests", "benchmarks") for file in (ROOT / folder).rglob("*.py")):
        top, *folders, _ = path.relative_to(ROOT).parts
        own = ".".join(folders) if top == "tests" else ""
        names = {module for module in imported_by(path) if inside_of(module) not in ("", own)}
        offences |= {(path.relative_to(ROOT).as_posix(), module) for module in names}
    advice = "import these from the folder, which offers them in its __init__, or move the test to that folder"
    assert sorted(offences - set(ALLOWED)) == [], advice
    assert sorted(set(ALLOWED) - offences) == [], "no longer needed: take them off the list"
