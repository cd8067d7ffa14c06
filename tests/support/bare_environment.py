"""An environment with the built package and its declared dependencies, from the packages installed here."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterator, Sequence
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from tests.support.places import ROOT

_SOURCES = ("calib", "hw", "scanner", "configs")
_FILES = ("pyproject.toml", "README.md", "LICENSE")
_NOT_ASKED_OF = {"bokeh"}  # draws the page of a Dask scheduler, which no test opens
_BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_{kind}(sys.argv[1]))"


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
