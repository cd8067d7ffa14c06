"""The table of costs: every processor second has one cause, and workers tell theirs."""

import os
import re
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from numba.core import event

from hw.simulated import SimulatedRoom
from tests.support.costs import (
    BROWSER,
    COMPILING,
    DRAWING,
    ENTRY_POINTS,
    OUTSIDE,
    PROCESSES,
    REST,
    Clocks,
    CostMeter,
    Costs,
    Stopwatch,
)
from tests.support.places import ROOT

SPENT = Clocks(own_s=5.0, children_s=2.0, wall_s=9.0, compiling_s=1.0, drawing_s=1.5)


def compute(seconds: float) -> None:
    """Spend processor time."""
    end_s = time.process_time() + seconds
    while time.process_time() < end_s:
        pass


def test_every_second_has_one_cause() -> None:
    costs = Costs()
    costs.add_test("a.py", SPENT, in_browser=False)
    costs.add_test("b.py", SPENT, in_browser=True)
    assert costs.by_cause == {PROCESSES: 2.0, COMPILING: 1.0, DRAWING: 1.5, REST: 2.5, BROWSER: 7.0}
    assert costs.by_file == {"a.py": 7.0, "b.py": 7.0}
    assert costs.waiting_s == 4.0
    assert costs.total_s == 14.0


def test_a_test_whose_processes_compute_beside_it_has_not_waited_less_than_nothing() -> None:
    costs = Costs()
    costs.add_test(
        "a.py", Clocks(own_s=1.0, children_s=8.0, wall_s=5.0, compiling_s=0.0, drawing_s=0.0), in_browser=False
    )
    assert costs.waiting_s == 0.0


def test_costs_of_processes_add_up() -> None:
    costs, other = Costs(), Costs()
    costs.add_test("a.py", SPENT, in_browser=False)
    other.add_test("a.py", SPENT, in_browser=False)
    other.add_test("b.py", SPENT, in_browser=True)
    costs.add(Costs.from_plain(other.as_plain()))
    assert costs.by_file == {"a.py": 14.0, "b.py": 7.0}
    assert costs.by_cause[REST] == 5.0
    assert costs.waiting_s == 6.0


def test_the_table_begins_with_the_most_expensive() -> None:
    costs = Costs()
    for number in range(12):
        costs.add_test(f"{number}.py", Clocks(number, 0.0, 2.0 * number, 0.0, 0.0), in_browser=False)
    costs.by_cause[OUTSIDE] += 100.0
    lines = list(costs.table())
    assert [line.split() for line in lines[:3]] == [
        ["166.0", "processor", "seconds,", "of", "these:"],
        ["100.0", *OUTSIDE.split()],
        ["66.0", *REST.split()],
    ]
    assert [line.split()[1] for line in lines[-10:]] == [f"{number}.py" for number in range(11, 1, -1)]


def test_calls_within_calls_count_once() -> None:
    """The clock of the processor runs on between two readings, so that a sum in a band is all that can be told."""
    watch = Stopwatch()
    begun_s = time.process_time()
    watch.around(lambda: watch.around(partial(compute, 0.05))())()
    spent_s = time.process_time() - begun_s
    assert 0.05 <= watch.total_s <= spent_s
    compute(0.01)
    assert watch.total_s <= spent_s


def test_a_failed_call_has_ended() -> None:
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError):
        watch.around(lambda: 1 / 0)()
    total_s = watch.total_s
    watch.around(partial(compute, 0.01))()
    assert watch.total_s >= total_s + 0.01


@pytest.mark.parametrize(("module", "entry"), [(m, entry) for m, entries in ENTRY_POINTS.items() for entry in entries])
def test_entry_points_are_methods_of_their_modules(module: str, entry: str) -> None:
    owner, method = entry.split(".")
    found = getattr(__import__(module, fromlist=[owner]), owner)
    assert callable(vars(found)[method])


def test_what_is_loaded_is_timed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[object] = []

    def draw(*arguments: object) -> None:
        drawn.append(arguments)
        compute(0.02)

    monkeypatch.setattr(SimulatedRoom, "electrons", draw)
    monkeypatch.setattr("tests.support.costs.ENTRY_POINTS", {"hw.simulated.simulation": ("SimulatedRoom.electrons",)})
    meter = CostMeter()
    for _ in range(2):
        meter.time_what_is_loaded()
    timed = vars(SimulatedRoom)["electrons"]
    assert timed.__wrapped__ is draw
    before = meter.clocks()
    timed(None, None)
    spent = meter.clocks().since(before)
    assert len(drawn) == 1
    assert 0.02 <= spent.drawing_s <= time.process_time()
    assert spent.compiling_s == 0.0


def test_compiling_is_timed_once_numba_is_loaded() -> None:
    meter = CostMeter()
    meter.time_what_is_loaded()
    before = meter.clocks()
    with event.trigger_event("numba:compile"):
        compute(0.02)
    compute(0.01)
    spent = meter.clocks().since(before)
    assert 0.02 <= spent.compiling_s < spent.own_s


@pytest.mark.parametrize(
    ("seconds", "asked", "printed"), [(59.0, False, False), (61.0, False, True), (1.0, True, True)]
)
def test_short_runs_print_when_asked(seconds: float, asked: bool, printed: bool) -> None:
    meter, lines = CostMeter(), list[str]()
    meter.costs.by_cause[REST] += seconds
    reporter: Any = SimpleNamespace(write_sep=lambda *_: None, write_line=lines.append)
    config: Any = SimpleNamespace(getoption=lambda _: asked)
    meter.pytest_terminal_summary(reporter, config)
    assert bool(lines) == printed


COMPUTING = """
import subprocess, sys, time
import pytest
COMPUTE = "import time\\nwhile time.process_time() < 0.1: pass"

def test_computes():
    exec(COMPUTE.replace("0.1", str(time.process_time() + 0.1)))

def test_starts_a_process():
    subprocess.run([sys.executable, "-c", COMPUTE], check=True)

@pytest.mark.xdist_group("browser")
def test_opens_a_page():
    exec(COMPUTE.replace("0.1", str(time.process_time() + 0.1)))
"""


@pytest.mark.parametrize("workers", [(), ("-n", "1")], ids=["one process", "a worker"])
def test_a_run_prints_what_it_cost(tmp_path: Path, workers: tuple[str, ...]) -> None:
    (tmp_path / "test_costly.py").write_text(COMPUTING, encoding="utf-8")
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n    xdist_group(name): -\n", encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.support.costs", "-p", "no:cacheprovider"]
    plain = ["-p", "no:hypothesispytest", "-p", "no:dash", *(workers or ["-p", "no:xdist"])]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [*command, "--costs", *plain], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
    rows = re.findall(r"^ *(\d+\.\d)  (.+)$", run.stdout, re.MULTILINE)
    seconds = {cause: float(value) for value, cause in rows}
    assert min(seconds[REST], seconds[PROCESSES]) >= 0.1
    assert seconds[BROWSER] >= 0.1
    assert seconds[OUTSIDE] > 0.1
    parts = [seconds.get(cause, 0.0) for cause in (PROCESSES, COMPILING, DRAWING, BROWSER, REST, OUTSIDE)]
    assert abs(seconds["processor seconds, of these:"] - sum(parts)) < 0.4  # rounded
    of_tests = sum(parts) - seconds[OUTSIDE]
    assert abs(seconds["test_costly.py"] - of_tests) < 0.4
