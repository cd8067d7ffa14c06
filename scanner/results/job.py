"""What makes a result: acquire → solve → write, in a folder that appears whole or not at all, with its provenance for
readers years later.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, TypeVar

from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.results.names import REFUSAL_FILE
from scanner.results.result_folder import new_result
from scanner.results.unfinished import published_name
from scanner.results.verdict import Verdict, verdict_entries, write_refusal
from scanner.ui import Terminal

Captures = TypeVar("Captures")
Solved = TypeVar("Solved")


@dataclass(frozen=True)
class Provenance:
    """The result's `name`, when it was `made` (UTC), by which `program`, and what its `configuration` sets."""

    name: str
    made: datetime
    program: str
    configuration: Mapping[str, Any]

    @property
    def date(self) -> str:
        """Date and time for reading."""
        return f"{self.made:%Y-%m-%d, %H:%M} UTC"

    def entries(self, devices: Mapping[str, str]) -> dict[str, Any]:
        """A key for a calibration file; `devices`: the capture's metadata."""
        return {
            "made": {
                "name": self.name,
                "date": self.made.isoformat(timespec="seconds"),
                "program": self.program,
                "configuration": {**self.configuration},
                "capture": {**devices},
            }
        }


def provenance(folder: Path, config: Config) -> Provenance:
    """Return the provenance of the result being made in `folder`, as of now."""
    settings = json.loads(config.as_json())
    return Provenance(published_name(folder), datetime.now(UTC), f"roomscan {version('roomscan')}", settings)


def refusal_of(verdict: Verdict) -> RefusalError:
    """The refusal that a verdict's most serious finding is."""
    return RefusalError.of(verdict.findings[0])


@dataclass(frozen=True)
class Job(Generic[Captures, Solved]):
    """The steps of a job whose result is kept whatever its grade: of a room, a thing or a network."""

    acquire: Callable[[Path], Captures]
    """Takes captures into the folder, or reads them from elsewhere. Raises InputError, DeviceError, RefusalError."""
    solve: Callable[[Captures], Solved]
    """Raises RefusalError."""
    write: Callable[[Solved, Path], Verdict]
    """Grades, and writes everything into the folder; returns the verdict. Raises OSError."""
    refuse: Callable[[Verdict], RefusalError] = refusal_of
    """The error for a verdict by which nothing can be trusted."""

    def run(self, config: Config, out: Path, *, is_live: bool, overwrite: bool, terminal: Terminal) -> Solved:
        """Make `out`. After a RefusalError it says why, for programs; captures of a job that `is_live` are kept.

        Raises InputError, DeviceError, StorageError, RefusalError.
        """
        with new_result(out, config, overwrite=overwrite, keep_capture=is_live, tell=terminal.note) as folder:
            try:
                solved = self.solve(self.acquire(folder))
                verdict = self.write(solved, folder)
                if verdict.grade == "refused":
                    raise self.refuse(verdict)
            except RefusalError as refusal:
                finding = refusal.finding
                refused = Verdict("refused", finding.message, (), finding.advice, (finding,), (finding.kind,))
                entries = provenance(folder, config).entries({}) | verdict_entries(refused)
                write_refusal(folder / REFUSAL_FILE, entries)
                raise
        return solved
