"""Time from a clone to a scanned room, in an empty folder with empty caches, and what each second went to.

    python benchmarks/bench_first_scan.py [--keep-packages]

Clones this repository and runs `make scan` there. The processes that it starts are looked at ten times a second: each
second by the clock goes to all that ran at that time, side by side, and each has its processor seconds. With
--keep-packages, packages come from pip's cache, as on a machine that has fetched them before.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table

LIMIT_S = 60.0
_ROOT = Path(__file__).parents[1]
_INTERVAL_S = 0.1
_TICKS = os.sysconf("SC_CLK_TCK")
# What a process does, by a word of its command line; the first that is found.
_STEPS = {
    "compile_ahead": "compiling",
    "/scan ": "scanning",
    "pip install": "installing packages",
    "pip/__pip-runner__": "installing packages",
    "ensurepip": "making the environment",
    "-m venv": "making the environment",
    "apt-get": "installing system packages",
    "dpkg": "installing system packages",
}
_REST = "the rest"
_RESULT = "scans/room-sim/report.html"


def _processes_of(root: int) -> dict[int, tuple[str, float]]:
    """The step, and the processor seconds so far, of each process that descends from one, by number."""
    parents: dict[int, int] = {}
    about: dict[int, tuple[str, float]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue  # it has ended meanwhile
        number = int(folder.name)
        parents[number] = int(fields[1])
        step = next((step for word, step in _STEPS.items() if word in line), _REST)
        about[number] = step, (int(fields[11]) + int(fields[12])) / _TICKS
    ours = {root}
    while more := {number for number, parent in parents.items() if parent in ours} - ours:
        ours |= more
    return {number: about[number] for number in ours - {root} if number in about}


class Watch:
    """Looks at the processes of a command until it ends."""

    def __init__(self, process: subprocess.Popen[str], result: Path) -> None:
        self._process, self._result = process, result
        self.clock_s: defaultdict[str, float] = defaultdict(float)
        self.processors_s: dict[int, tuple[str, float]] = {}
        self.result_s: float | None = None
        self._thread = threading.Thread(target=self._watch)

    def run(self) -> float:
        """Wait for the command; returns its seconds by the clock."""
        begin_s = time.perf_counter()
        self._begin_s = begin_s
        self._thread.start()
        self._process.wait()
        self._thread.join()
        return time.perf_counter() - begin_s

    def _watch(self) -> None:
        before_s = time.perf_counter()
        while self._process.poll() is None:
            time.sleep(_INTERVAL_S)
            found = _processes_of(self._process.pid)
            now_s = time.perf_counter()
            steps = sorted({step for step, _ in found.values()} - {_REST}) or [_REST]
            self.clock_s[" and ".join(steps)] += now_s - before_s
            for number, (step, seconds) in found.items():
                before = self.processors_s.get(number)  # one that has ended has no command line any more
                self.processors_s[number] = (before[0] if before and step == _REST else step), seconds
            before_s = now_s
            if self.result_s is None and self._result.exists():
                self.result_s = now_s - self._begin_s


def _largest_first(seconds: Mapping[str, float]) -> list[tuple[str, float]]:
    return sorted(seconds.items(), key=lambda item: -item[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep-packages", action="store_true", help="take packages from pip's cache")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="first-scan-") as place:
        clone = Path(place) / "roomscan"
        begin_s = time.perf_counter()
        subprocess.run(["git", "clone", "--quiet", _ROOT, clone], check=True)
        cloned_s = time.perf_counter() - begin_s
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        if not options.keep_packages:
            environment |= {"PIP_CACHE_DIR": f"{place}/pip"}
        environment |= {"XDG_CACHE_HOME": f"{place}/cache"}
        with (Path(place) / "output.txt").open("w+") as output:
            process = subprocess.Popen(
                ["make", "scan"], cwd=clone, env=environment, stdout=output, stderr=subprocess.STDOUT, text=True
            )
            watch = Watch(process, clone / _RESULT)
            total_s = watch.run()
            output.seek(0)
            if process.returncode or watch.result_s is None:
                sys.exit(f"make scan failed:\n{output.read()}")
    table = Table(title="From a clone to a scanned room")
    for column in ("what ran", "s by the clock"):
        table.add_column(column, justify="left" if column == "what ran" else "right")
    table.add_row("git clone", f"{cloned_s:.1f}")
    for steps, seconds in _largest_first(watch.clock_s):
        table.add_row(steps, f"{seconds:.1f}")
    by_step: defaultdict[str, float] = defaultdict(float)
    for step, seconds in watch.processors_s.values():
        by_step[step] += seconds
    console = Console()
    console.print(table)
    console.print(
        "Processor seconds: " + ", ".join(f"{step} {seconds:.1f}" for step, seconds in _largest_first(by_step))
    )
    to_result_s = cloned_s + watch.result_s
    share = to_result_s / LIMIT_S
    console.print(f"The result was there after {to_result_s:.1f} s ({share:.2f} of the limit, {LIMIT_S:g} s)")
    console.print(f"Everything was set up after {cloned_s + total_s:.1f} s")


if __name__ == "__main__":
    main()
