"""What is loaded before a command says that something is wrong, and with the jobs: nothing that takes long."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.places import ROOT

COMMAND = "import sys; from scanner.commands import main; main(sys.argv[1:]); print(*sys.modules)"
JOBS = "import sys, scanner.jobs; print(*sys.modules)"
# SciPy's folders load each other, for a third of a second: they are named where they are used, as in scipy.linalg.qr.
IN_USE = {
    "hw.simulated",
    "jinja2",
    "numba",
    "open3d",
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.sparse",
}
IN_USE |= {"scipy.spatial", "scipy.special"}
COMPUTING = {"calib.numerics", "cv2", "numba", "numpy", "pydantic", "scanner.configuration", "scipy", "yaml"}
ESTIMATING = {"calib.networks", "calib.registration", "calib.scene", "scanner.decoding", "scanner.jobs"}


def loaded(script: str, *arguments: str) -> set[str]:
    """The modules that a process has loaded at its end."""
    command = [sys.executable, "-c", script, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "arguments",
    [("replay", "nowhere"), ("--config", "nowhere.yaml"), ("photos", "none.jpg", "--out", "out"), ("repaly",)],
    ids=" ".join,
)
def test_a_wrong_word_or_path_is_told_before_anything_is_loaded(arguments: tuple[str, ...]) -> None:
    assert not loaded(COMMAND, *arguments) & COMPUTING


def test_a_wrong_key_is_told_by_those_who_read_configurations(tmp_path: Path) -> None:
    (tmp_path / "room.yaml").write_text("camera: {widht: 640, height: 480}\n")
    assert not loaded(COMMAND, "--config", str(tmp_path / "room.yaml")) & (IN_USE | ESTIMATING)


def test_jobs_load_only_what_all_of_them_use() -> None:
    modules = loaded(JOBS)
    assert not modules & IN_USE
    assert {"numpy", "scanner.decoding", "scipy"} < modules
