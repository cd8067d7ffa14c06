"""An experiment's parts, and the files of their results."""

import importlib.metadata
import json
import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from paper.captures import Setup

Figures = dict[str, Any]  # the JSON values of one part
PACKAGES = ("numpy", "scipy", "opencv-python-headless", "pycolmap")


@dataclass(frozen=True)
class Experiment:
    """`parts`: keys of the parts, measured in sequence; `measure` returns the values of one.

    `needs_colmap`: it is left out without pycolmap, and the page says so.
    """

    name: str
    parts: Callable[[Setup], list[str]]
    measure: Callable[[Setup, str], Figures]
    needs_colmap: bool = False


@dataclass(frozen=True)
class Results:
    """A folder with a JSON file for each experiment."""

    folder: Path

    def read(self, name: str) -> dict[str, Figures]:
        """The measured parts of an experiment; empty if it was not run."""
        return dict(self._document(name)["parts"])

    def made_with(self, name: str) -> Figures:
        """Command, sizes and versions."""
        return dict(self._document(name)["made_with"])

    def keep(self, name: str, part: str, figures: Figures, made_with: Figures) -> None:
        """Add or replace a part; parts made with other settings are dropped."""
        document = self._document(name)
        parts = document["parts"] if document["made_with"] == made_with else {}
        self.folder.mkdir(parents=True, exist_ok=True)
        whole = {"made_with": made_with, "parts": parts | {part: figures}}
        partial = self.folder / f"{name}.json.part"
        partial.write_text(json.dumps(whole, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        partial.replace(self.folder / f"{name}.json")

    def _document(self, name: str) -> Figures:
        path = self.folder / f"{name}.json"
        if not path.exists():
            return {"made_with": {}, "parts": {}}
        document: Figures = json.loads(path.read_text(encoding="utf-8"))
        return document


def rooms(setup: Setup) -> list[str]:
    """Parts by rooms, named by their seeds."""
    return [f"room {room}" for room in setup.rooms]


def room_of(part: str) -> int:
    return int(part.removeprefix("room "))


def made_with(setup: Setup) -> Figures:
    """What figures depend on beside the code: sizes and the versions of what computes them."""
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "camera": list(setup.camera_size),
        "projector": list(setup.projector_size),
        "quick": setup.quick,
        "versions": versions,
    }


def run(experiment: Experiment, setup: Setup, results: Results, *, only_missing: bool) -> None:
    """Measure all parts, or the missing ones, and save each once it is measured."""
    with_these = made_with(setup)
    for part in experiment.parts(setup):
        there = results.made_with(experiment.name) == with_these and part in results.read(experiment.name)
        if there and only_missing:
            continue
        print(f"{experiment.name}, {part}", flush=True)
        results.keep(experiment.name, part, experiment.measure(setup, part), with_these)
