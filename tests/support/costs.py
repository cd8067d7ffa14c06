"""What a run of the tests costs: processor seconds by cause and by file, printed at its end.

A plugin of pytest, which tests/conftest.py registers. A run that costs less than a minute prints nothing, unless it is
asked to:

    pytest --costs tests/scanner/io

What a test's own process spends in compiling and in drawing simulated scenes is told apart; of processes that tests
start, and of a browser, only the sum is known, when they have ended. So what a process spent is counted for the test
during which it ended.
"""

import os
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import wraps
from types import MappingProxyType, ModuleType
from typing import Any

import pytest

PROCESSES = "processes that tests start"
COMPILING = "compiling"
DRAWING = "drawing simulated scenes"
BROWSER = "pages in a browser"
REST = "all the rest of the tests"
OUTSIDE = "outside of tests: imports, collecting"
_BROWSER_GROUP = "browser"
_FILES = 10
_WORTH_TELLING_S = 60.0

# The entry points of what draws scenes, by module: methods, which are looked up in their class at every call.
ENTRY_POINTS: Mapping[str, tuple[str, ...]] = {
    "hw.simulated.rig": ("SimulatedCamera.grab",),
    "hw.simulated.scene": ("Scene.cast",),
    "hw.simulated.simulation": (
        "SimulatedRoom.__init__",
        "SimulatedRoom.under",
        "SimulatedRoom.at",
        "SimulatedRoom.electrons",
        "SimulatedRoom.ground_truth",
    ),
    "hw.simulated.things.simulation": ("SimulatedThing.__init__", "SimulatedThing.seen"),
    "tests.support.room": ("Room.cast", "FilmedRoom.film"),
    "tests.support.synthetic_capture": ("Scene.frame", "Scene.well_lit"),
}


class Stopwatch:
    """Processor seconds of this process while anybody is inside."""

    def __init__(self) -> None:
        self.total_s = 0.0
        self._inside = 0
        self._begun_s = 0.0
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._begun_s = time.process_time()
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self.total_s += time.process_time() - self._begun_s

    def around(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, timed."""

        @wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            with self:
                return function(*arguments, **named)

        return timed


@dataclass(frozen=True)
class Clocks:
    """Seconds of this process since it began."""

    own_s: float
    """Of its processors."""
    children_s: float
    """Of the processors of processes that it started and that have ended."""
    wall_s: float
    """On the wall."""
    compiling_s: float
    """Of its processors, in the compiler."""
    drawing_s: float
    """Of its processors, drawing scenes."""

    def since(self, before: "Clocks") -> "Clocks":
        """What has passed."""
        return Clocks(
            self.own_s - before.own_s,
            self.children_s - before.children_s,
            self.wall_s - before.wall_s,
            self.compiling_s - before.compiling_s,
            self.drawing_s - before.drawing_s,
        )


def _nothing(known: Mapping[str, float] = MappingProxyType({})) -> defaultdict[str, float]:
    """Seconds by name, 0 for those that are not known."""
    return defaultdict(float, known)


def _largest(seconds: Mapping[str, float]) -> list[tuple[str, float]]:
    """Names with their seconds, the largest first."""
    return sorted(seconds.items(), key=lambda item: -item[1])


@dataclass
class Costs:
    """The costs of one process, or of several added up."""

    by_cause: dict[str, float] = field(default_factory=_nothing)
    """Processor seconds."""
    by_file: dict[str, float] = field(default_factory=_nothing)
    """Processor seconds of the tests of each file."""
    waiting_s: float = 0.0
    """For how long tests did not compute: they waited for a device, a process, or a processor."""

    @property
    def total_s(self) -> float:
        """All processor seconds."""
        return sum(self.by_cause.values())

    def add_test(self, file: str, spent: Clocks, *, in_browser: bool) -> None:
        """Add what a test spent."""
        if in_browser:
            self.by_cause[BROWSER] += spent.own_s + spent.children_s
        else:
            self.by_cause[PROCESSES] += spent.children_s
            self.by_cause[COMPILING] += spent.compiling_s
            self.by_cause[DRAWING] += spent.drawing_s
            self.by_cause[REST] += spent.own_s - spent.compiling_s - spent.drawing_s
        self.by_file[file] += spent.own_s + spent.children_s
        self.waiting_s += max(spent.wall_s - spent.own_s - spent.children_s, 0.0)

    def add(self, other: "Costs") -> None:
        """Add those of another process."""
        for own, others in ((self.by_cause, other.by_cause), (self.by_file, other.by_file)):
            for name, seconds in others.items():
                own[name] += seconds
        self.waiting_s += other.waiting_s

    def as_plain(self) -> dict[str, Any]:
        """As processes send it to each other."""
        return {"by_cause": dict(self.by_cause), "by_file": dict(self.by_file), "waiting_s": self.waiting_s}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> "Costs":
        """What `as_plain` made."""
        return cls(_nothing(plain["by_cause"]), _nothing(plain["by_file"]), plain["waiting_s"])

    def table(self) -> Iterator[str]:
        """Lines to print: the causes, then the most expensive files."""
        yield f"{self.total_s:8.1f}  processor seconds, of these:"
        for cause, seconds in _largest(self.by_cause):
            yield f"{seconds:8.1f}  {cause}"
        yield f"{self.waiting_s:8.1f}  seconds of waiting: for devices, processes, a processor"
        yield f"The {min(_FILES, len(self.by_file))} most expensive files:"
        for file, seconds in _largest(self.by_file)[:_FILES]:
            yield f"{seconds:8.1f}  {file}"


class CostMeter:
    """The plugin of one process of pytest."""

    def __init__(self) -> None:
        self.costs = Costs()
        self._compiling, self._drawing = Stopwatch(), Stopwatch()
        self._timed: set[str] = set()
        self._listens = False

    def clocks(self) -> Clocks:
        """As they stand."""
        times = os.times()
        return Clocks(
            time.process_time(),  # finer than the ticks of `times`
            times.children_user + times.children_system,
            time.monotonic(),
            self._compiling.total_s,
            self._drawing.total_s,
        )

    def time_what_is_loaded(self) -> None:
        """Time the compiler and the entry points of modules that have been loaded meanwhile; load none."""
        event = sys.modules.get("numba.core.event")
        if event is not None and not self._listens:
            _listen(event, self._compiling)
            self._listens = True
        for module in [name for name in ENTRY_POINTS if name in sys.modules and name not in self._timed]:
            self._timed.add(module)
            for entry in ENTRY_POINTS[module]:
                owner, method = entry.split(".")
                found = getattr(sys.modules[module], owner)
                setattr(found, method, self._drawing.around(getattr(found, method)))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Measure a test with its fixtures."""
        self.time_what_is_loaded()
        before = self.clocks()
        result = yield
        groups = {group for mark in item.iter_markers("xdist_group") for group in (*mark.args, *mark.kwargs.values())}
        spent = self.clocks().since(before)
        self.costs.add_test(item.location[0], spent, in_browser=_BROWSER_GROUP in groups)
        return result

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Add what belongs to no test; a worker sends all to the process that started it."""
        clocks = self.clocks()
        output: dict[str, Any] | None = getattr(session.config, "workeroutput", None)
        # Workers are children, too, and tell themselves what they spent.
        has_workers = bool(getattr(session.config.option, "numprocesses", None)) and output is None
        all_s = clocks.own_s + (0.0 if has_workers else clocks.children_s)
        own = sum(self.costs.by_file.values()) if not has_workers else 0.0
        self.costs.by_cause[OUTSIDE] += all_s - own
        if output is not None:
            output["costs"] = self.costs.as_plain()

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Add what a worker has sent; one that crashed has sent nothing."""
        sent = getattr(node, "workeroutput", {}).get("costs")
        if sent is not None:
            self.costs.add(Costs.from_plain(sent))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
        """Print the table."""
        if config.getoption("--costs") or self.costs.total_s > _WORTH_TELLING_S:
            terminalreporter.write_sep("=", "costs")
            for line in self.costs.table():
                terminalreporter.write_line(line)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Whether to print always."""
    parser.addoption("--costs", action="store_true", help="print processor seconds by cause, of a short run too")


def pytest_configure(config: pytest.Config) -> None:
    """Begin to measure."""
    config.pluginmanager.register(CostMeter())


def _listen(event: ModuleType, stopwatch: Stopwatch) -> None:
    """Time what numba compiles; what it loads from its cache is no compiling."""

    class Compiling(event.Listener):  # type: ignore[name-defined, misc]
        def on_start(self, _event: object) -> None:
            stopwatch.__enter__()

        def on_end(self, _event: object) -> None:
            stopwatch.__exit__()

    event.register("numba:compile", Compiling())
