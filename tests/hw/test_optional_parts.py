"""Commands that install missing parts, for each kind of installation."""

import sys
import tomllib
from pathlib import Path

import pytest

from hw import optional_parts
from hw.optional_parts import CONSOLE, PARTS, RIG
from tests.support.places import ROOT


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout whose Makefile created the environment, as the current folder."""
    folder = tmp_path / "check out"
    folder.mkdir()
    (folder / "pyproject.toml").touch()
    monkeypatch.setattr(optional_parts, "_FOLDER", folder)
    monkeypatch.setattr(sys, "prefix", str(folder / ".venv"))
    monkeypatch.setattr(sys, "executable", str(folder / ".venv/bin/python"))
    monkeypatch.chdir(folder)
    return folder


def test_the_command_keeps_a_checkout_editable(checkout: Path) -> None:
    assert CONSOLE.install_command() == ".venv/bin/python -m pip install -e '.[console]'"
    assert RIG.install_command() == "make rig"


def test_from_another_folder_the_command_has_absolute_paths(
    checkout: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    python = f"'{checkout}/.venv/bin/python'"
    assert CONSOLE.install_command() == f"{python} -m pip install -e '{checkout}[console]'"
    assert RIG.install_command() == f"make -C '{checkout}' rig"


def test_a_checkout_in_another_environment(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", "/opt/other")
    monkeypatch.setattr(sys, "executable", "/opt/other/bin/python")
    assert CONSOLE.install_command() == "/opt/other/bin/python -m pip install -e '.[console]'"
    assert RIG.install_command().startswith("sudo apt-get install gir1.2-aravis-0.8 ")
    assert RIG.install_command().endswith(" && /opt/other/bin/python -m pip install -e '.[rig]'")


def test_a_package(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (checkout / "pyproject.toml").unlink()
    monkeypatch.setattr(sys, "prefix", "/opt/other")
    monkeypatch.setattr(sys, "executable", "/opt/other/bin/python")
    assert CONSOLE.install_command() == "/opt/other/bin/python -m pip install 'roomscan[console]'"


def test_the_table_matches_the_extras_of_the_package() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        extras = set(tomllib.load(file)["project"]["optional-dependencies"])
    assert {part.extra for part in PARTS} == extras - {"dev", "bench"}  # which no user of the program needs
