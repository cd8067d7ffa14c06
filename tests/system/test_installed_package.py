"""The built package with only its dependencies, and with one extra: every command responds.

An environment with the built package and its declared dependencies, from the packages installed here.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from scanner.commands import NAMED
from tests.support.places import ROOT

_SOURCES = ("calib", "hw", "scanner", "configs")
_FILES = ("pyproject.toml", "README.md", "LICENSE")
_NOT_ASKED_OF = {"bokeh"}  # draws the page of a Dask scheduler, which no test opens
_BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_{kind}(sys.argv[1]))"
pytestmark = pytest.mark.xdist_group("installed package")

CONFIG = """
rig: {backend: simulated, seed: 0, furniture: false, interreflection: false, ambient: 0}
camera: {width: 306, height: 256, principal_point: {known: [157.04, 131.79]}}
projector: {width: 214, height: 120}
sequence: {preset: quick}
corner: {squareness_deg: 0}
"""
# Arguments come from stdin, and for each the exit code and what was said go to stdout.
DRIVER = """
import contextlib, io, json, sys
if __name__ == "__main__":
    from scanner.commands.main import main
    answers = []
    for arguments in json.load(sys.stdin):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code = main(arguments)
            except SystemExit as end:
                code = end.code or 0
        answers.append([code, out.getvalue(), err.getvalue()])
    json.dump(answers, sys.stdout)
"""
# What each is asked with what a first scan left, the exit code, and words that it says; other commands show their help.
SCAN = ("--config", "room.yaml", "--out", "one")
ASKED: dict[str, list[tuple[tuple[str, ...], int, str]]] = {
    "new": [(("mine.yaml",), 0, "→ scan --config mine.yaml"), (("rig.yaml", "--rig", "aravis"), 0, "type: ")],
    "replay": [(("one/capture", "--config", "room.yaml", "--out", "again"), 0, "→ ")],
    "calibrate": [(("one", "--config", "room.yaml", "--out", "from-matches"), 0, "→ ")],
    "batch": [(("one", "--config", "room.yaml", "--out", "many", "--workers", "1"), 0, "batch.csv")],
    "patterns": [
        (("--config", "room.yaml", "--out", "patterns"), 0, "→ "),
        (
            ("--config", "room.yaml", "--out", "film", "--video", "film.mp4"),
            2,
            "video needs av, which is not installed",
        ),
    ],
    "devices": [((), 3, "type: ")],
    "export": [
        (("one", "--to", "opencv"), 0, "→ "),
        (("one", "--to", "mesh"), 0, "→ "),
        (("one", "--to", "e57"), 2, "E57 needs pye57, which is not installed; type: "),
    ],
    "clean": [(("one", "--outliers"), 0, "→ "), (("one", "--undo"), 0, "→ ")],
    "section": [(("one", "--plane", "z=9999"), 2, "meets no triangle")],
    "measure": [(("one",), 0, "→ ")],
    "accept": [(("one", "--ball-bar", "50mm,50mm,200mm"), 2, "scale.baseline_m")],
    "view": [(("one",), 2, "needs viser, which is not installed; type: ")],
    "console": [(("--config", "room.yaml"), 2, "needs viser, which is not installed; type: ")],
    "photos": [(("room.yaml", "rig.yaml", "--out", "photos"), 2, "room.yaml")],
    "board": [(("--print", "charuco:A4"), 0, "→ Print it")],
    "room": [(("one", "one", "--config", "room.yaml", "--out", "whole"), 2, "one")],
    "compare": [(("one", "again"), 0, "→ ")],
    "register": [(("one", "--out", "registered"), 2, "expected two clouds or more")],
    "import": [(("patterns", "--from", "opencv"), 2, "patterns")],
}
WITH_EXTRA = {
    "batch": (("batch", "one", "--config", "room.yaml", "--out", "table", "--workers", "1"), 0, "batch.parquet"),
    "console": (("view", "nothing"), 2, "nothing"),
    "e57": (("export", "one", "--to", "e57"), 0, "→ "),
    "las": (("export", "one", "--to", "las"), 0, "→ "),
    "step": (("compare", "one", "part.step"), 2, "found a damaged file"),
    "video": (("patterns", "--config", "room.yaml", "--out", "film", "--video", "film.mp4"), 0, "film.mp4"),
    "rig": (("devices",), None, ""),
}


def built(folder: Path, kind: str = "wheel") -> Path:
    """The wheel, or the sdist, of a copy of the sources, built in `folder`. Skips if setuptools is too old."""
    try:
        old = Version(distribution("setuptools").version) < Version("77")
    except PackageNotFoundError:
        old = True
    if old:
        pytest.skip("setuptools 77 or newer is not installed: pip install 'setuptools>=77'")
    copy = folder / "sources"
    for name in _SOURCES:
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in _FILES:
        shutil.copyfile(ROOT / name, copy / name)
    command = [sys.executable, "-c", _BUILD.format(kind=kind), str(folder)]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=True)
    shutil.rmtree(copy)
    return folder / done.stdout.splitlines()[-1]


def installed(wheel: Path, folder: Path, extras: Sequence[str] = ()) -> Path:
    """The Python of a new environment with our wheel and its dependencies, which are linked from this environment.

    Skips if packages of an extra are not installed here.
    """
    venv.create(folder, with_pip=False, symlinks=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)}))
    unpacked = wheel.with_suffix("")  # once for all environments, which so share its bytecode
    if not unpacked.exists():
        with ZipFile(wheel) as file:  # of Python only: an installer only unpacks it, and makes the command's file
            file.extractall(unpacked)
    for own in unpacked.iterdir():
        (packages / own.name).symlink_to(own)
    (roomscan,) = (Distribution.at(path) for path in packages.glob("roomscan-*.dist-info"))
    for needed in _needed(roomscan, extras, {}).values():
        for name in {file.parts[0] for file in needed.files or () if file.parts[0] not in ("..", "__pycache__")}:
            if not (packages / name).exists():
                (packages / name).symlink_to(Path(str(needed.locate_file(name))))
    return folder / "bin" / "python"


def _needed(package: Distribution, extras: Sequence[str], found: dict[str, Distribution]) -> dict[str, Distribution]:
    """The dependencies of a package here, recursively, by name."""
    for requirement in _requirements(package, extras):
        name = requirement.name.lower()
        try:
            needed = distribution(name)
        except PackageNotFoundError:
            if name in _NOT_ASKED_OF:
                continue
            pytest.skip(f"{requirement} is not installed")
        if name not in found:
            found[name] = needed
            _needed(needed, tuple(requirement.extras), found)
    return found


def _requirements(package: Distribution, extras: Sequence[str]) -> Iterator[Requirement]:
    for text in package.requires or ():
        requirement = Requirement(text)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield requirement


def environment() -> dict[str, str]:
    """Environment variables without those that add packages of other environments."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


@dataclass(frozen=True)
class Installed:
    wheel: Path
    folder: Path

    def answers(self, python: Path, *commands: tuple[str, ...]) -> list[tuple[int, str]]:
        """Exit codes and output of commands in one process."""
        command = [str(python), str(self.folder / "driver.py")]
        done = subprocess.run(
            command,
            input=json.dumps(commands),
            env=environment(),
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return [(code, out + err) for code, out, err in json.loads(done.stdout)]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("elsewhere")
    (folder / "room.yaml").write_text(CONFIG)
    (folder / "driver.py").write_text(DRIVER)
    (folder / "part.step").write_text("ISO-10303-21;\n")
    return Installed(built(tmp_path_factory.mktemp("wheel")), folder)


@pytest.fixture(scope="module")
def bare(package: Installed, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, ...], tuple[int, str]]:
    """Words that every command prints without any extra."""
    python = installed(package.wheel, tmp_path_factory.mktemp("bare"))
    asked = [SCAN, *((name, *words) for name in NAMED for words, *_ in ASKED.get(name, [(("--help",), 0, "")]))]
    return dict(zip(asked, package.answers(python, *asked), strict=True))


def test_a_scan_works(bare: dict[tuple[str, ...], tuple[int, str]]) -> None:
    code, said = bare[SCAN]
    assert code == 0, said
    assert "→ " in said


@pytest.mark.parametrize("name", NAMED)
def test_every_command_works_or_names_what_to_install(name: str, bare: dict[tuple[str, ...], tuple[int, str]]) -> None:
    for words, expected, part in ASKED.get(name, [(("--help",), 0, "usage: scan")]):
        code, said = bare[name, *words]
        assert (code, part in said) == (expected, True), said
        if "type: " in said:
            assert " -m pip install 'roomscan[" in said  # this is no checkout


@pytest.mark.usefixtures("bare")
@pytest.mark.parametrize("extra", WITH_EXTRA)
def test_an_extra_enables_its_commands(extra: str, package: Installed, tmp_path: Path) -> None:
    python = installed(package.wheel, tmp_path / "with-extra", [extra])
    words, expected, part = WITH_EXTRA[extra]
    ((code, said),) = package.answers(python, words)
    assert code == expected or (expected is None and code in (0, 3)), said
    assert part in said
    assert f"'roomscan[{extra}]'" not in said or extra == "rig"  # which needs packages of the system, too


def test_the_wheel_has_the_files_of_the_sources(package: Installed) -> None:
    found = set(ZipFile(package.wheel).namelist())
    for packages, ending in ((("calib", "hw", "scanner"), "*.py"), (("scanner/templates",), "*.*")):
        for name in packages:
            for path in (ROOT / name).rglob(ending):
                assert path.relative_to(ROOT).as_posix() in found
    configurations = {path.name for path in (ROOT / "configs").glob("*.yaml")}
    assert {Path(name).name for name in found if "examples/" in name} == configurations
    assert {name.split("/")[0] for name in found if "dist-info" not in name} == {"calib", "hw", "scanner"}


def test_the_sdist_has_the_sources_of_the_wheel(package: Installed, tmp_path: Path) -> None:
    sdist = built(tmp_path, "sdist")
    with tarfile.open(sdist) as file:
        found = {name.partition("/")[2] for name in file.getnames() if file.getmember(name).isfile()}
    wanted = {name for name in ZipFile(package.wheel).namelist() if "dist-info" not in name}
    assert wanted <= found
