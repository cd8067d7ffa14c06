"""Who runs a line, by a record and by what functions name."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.places import ROOT
from tools.covering_tests import CoveringTests

CALLED = "calib/numerics/robust.py:robust_sigmas"


def line_of(path: str, text: str) -> int:
    """The number of the first line that has a text."""
    lines = (ROOT / path).read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


def covering(folder: Path, calls: dict[str, list[str]]) -> CoveringTests:
    record = folder / "record.jsonl"
    entries = [{"test": test, "seconds": 1.0, "functions": functions} for test, functions in calls.items()]
    record.write_text("".join(json.dumps(entry) + "\n" for entry in entries), encoding="utf-8")
    return CoveringTests(record)


def test_a_record_names_the_functions_that_a_test_calls(tmp_path: Path) -> None:
    record = tmp_path / "record.jsonl"
    test = "tests/calib/numerics/test_robust.py::test_sigmas_ignore_a_fifth_of_outliers"
    plugin = ["-p", "tools.called_functions", "-p", "no:cacheprovider", f"--called-functions={record}"]
    for _ in range(2):  # the second time there is nothing left to record
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        run = subprocess.run([sys.executable, "-m", "pytest", *plugin, test], cwd=ROOT, env=environment)
        assert run.returncode in (0, 5)
    (entry,) = map(json.loads, record.read_text(encoding="utf-8").splitlines())
    assert entry["test"] == test
    assert CALLED in entry["functions"]
    assert not [function for function in entry["functions"] if not function.startswith(("calib/", "hw/", "scanner/"))]


@pytest.mark.parametrize(
    ("path", "text", "caller"),
    [
        # A function of Python; a compiled one, which a compiled one calls; and a constant.
        ("calib/geometry/camera.py", "pixels += np.array(self.principal_point_px)", "camera.py:Intrinsics.project"),
        ("calib/geometry/radial_distortion.py", "return x - step_x, y - step_y", "radial_distortion.py:undistort"),
        ("calib/geometry/radial_distortion.py", "_CONVERGED, _INVERTED = 1e-6", "radial_distortion.py:undistort"),
    ],
)
def test_a_line_is_run_by_who_calls_its_function_or_names_it(tmp_path: Path, path: str, text: str, caller: str) -> None:
    calls = {"tests/calib/geometry/test_a.py::test": [f"calib/geometry/{caller}"], "tests/test_b.py::test": []}
    tests = covering(tmp_path, calls).of_line(Path(path), line_of(path, text))
    assert tests == ["tests/calib/geometry/test_a.py::test"]


def test_the_nearest_tests_come_first(tmp_path: Path) -> None:
    path, call = "calib/geometry/camera.py", ["calib/geometry/camera.py:Intrinsics.project"]
    calls = {"tests/calib/a.py::far": call, "tests/calib/geometry/b.py::near": call, "tests/hw/c.py::none": []}
    tests = covering(tmp_path, calls).of_line(Path(path), line_of(path, "pixels *= np.array(self.focal_px)"))
    assert tests == ["tests/calib/geometry/b.py::near", "tests/calib/a.py::far"]
