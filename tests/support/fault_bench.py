"""Scans as processes with injected faults, and their remains."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.support.fault_process import CANNOT_MOUNT
from tests.support.places import ROOT


@dataclass(frozen=True)
class Ended:
    """`code`: the exit code, or minus the signal. `files`: those of the mounted file system."""

    code: int
    said: str
    files: Mapping[str, str]


class FaultBench:
    """The process that forks scanners while the block lasts."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "tests.support.fault_process"]
        self._process = subprocess.Popen(
            command, cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=1
        )
        assert self._process.stdout.readline() == "ready\n"

    def __enter__(self) -> "FaultBench":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def run(self, folder: Path, *arguments: object, faults: Sequence[Mapping[str, Any]] = (), **request: Any) -> Ended:
        """Run `scan` with these arguments; `request` holds parameters of the fault. Skips where mounting is not
        allowed.
        """
        report = folder / "said.txt"
        asked = {"arguments": [*map(str, arguments)], "faults": [*faults], "report": str(report), **request}
        self._process.stdin.write(json.dumps(asked, default=str) + "\n")
        code = int(self._process.stdout.readline())
        if code == CANNOT_MOUNT:
            pytest.skip("this machine does not let a test mount a file system of its own")
        listed = report.with_suffix(".tree")
        files = json.loads(listed.read_text()) if listed.exists() else {}
        return Ended(code, report.read_text(), files)
