"""Runs a target in a separate process, input after input, and detects exceptions, hangs and memory use.

Input number i of a seed is always the same, so a finding is identified by target, seed and number.
"""

import argparse
import os
import resource
import select
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

HANG_S = 5.0  # of the processor's time; of the clock's several times as much, for the machine may be busy
_SILENT_S, _SETUP_S = 60.0, 600.0
MOST_BYTES = 1_000_000_000
_GUARD_BYTES = 4_000_000_000  # more address space is not given at all


@dataclass(frozen=True)
class Finding:
    """A failure: a foreign exception, a hang, or too much memory."""

    target: str
    seed: int
    number: int
    what: str
    details: str = ""


@dataclass(frozen=True)
class Outcome:
    """Number of `inputs` run and `accepted`, and the findings, one of each kind."""

    target: str
    inputs: int
    accepted: int
    findings: tuple[Finding, ...]
    kinds: Counter[str]


def fuzz(target: str, *, seed: int, inputs: int, seconds: float, hang_s: float = HANG_S) -> Outcome:
    """Run inputs of a target up to a number or a time, restarting the process if it dies."""
    findings: dict[str, Finding] = {}
    kinds: Counter[str] = Counter()
    end = time.monotonic() + seconds
    with tempfile.NamedTemporaryFile() as file:
        progress = _Progress(file.fileno())
        progress.tell(0, 0)
        while progress.number < inputs and time.monotonic() < end:
            for number, what, details in _watched(
                [target, str(seed), str(inputs), file.name, str(hang_s)], progress, end
            ):
                kinds[what] += 1
                findings.setdefault(what, Finding(target, seed, number, what, details))
        return Outcome(target, progress.number, progress.accepted, tuple(findings.values()), kinds)


class _Progress:
    """Number of inputs begun and accepted, in a file shared by two processes."""

    _NUMBERS = struct.Struct("qq")

    def __init__(self, file: int) -> None:
        self._file = file

    def tell(self, number: int, accepted: int) -> None:
        os.pwrite(self._file, self._NUMBERS.pack(number, accepted), 0)

    @property
    def number(self) -> int:
        return int(self._read()[0])

    @property
    def accepted(self) -> int:
        return int(self._read()[1])

    def _read(self) -> tuple[int, ...]:
        return self._NUMBERS.unpack(os.pread(self._file, self._NUMBERS.size, 0))


def _watched(arguments: list[str], progress: _Progress, end: float) -> Iterator[tuple[int, str, str]]:
    """The findings of one process, including its death; then the next input is run."""
    command = [sys.executable, "-m", "tests.fuzz", "--worker", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, bufsize=0) as process:
        assert process.stdout is not None
        last, since, patience = progress.number, time.monotonic(), _SETUP_S
        try:
            while time.monotonic() < end:
                if select.select([process.stdout], [], [], 0.5)[0]:
                    line = process.stdout.readline().decode()
                    if line:
                        number, what, details = line.rstrip("\n").split("\t")
                        yield int(number), what, details
                    elif process.wait() == 0:
                        return
                    else:
                        yield progress.number, f"died: exit code {process.returncode}", ""
                        progress.tell(progress.number + 1, progress.accepted)
                        return
                elif progress.number != last:
                    last, since, patience = progress.number, time.monotonic(), _SILENT_S
                elif time.monotonic() - since > patience:
                    yield last, f"hang: {patience:.0f} s", ""
                    progress.tell(last + 1, progress.accepted)
                    return
        finally:
            process.kill()


def work(target: str, seed: int, inputs: int, shared: Path, hang_s: float) -> None:
    """Run inputs in sequence, and report findings on stdout."""
    os.environ["OPENCV_LOG_LEVEL"] = "SILENT"
    from tests.fuzz.guarded import RejectedError, rng_of
    from tests.fuzz.targets import PLANTED, TARGETS

    with (
        os.fdopen(os.dup(1), "w") as told,
        tempfile.TemporaryDirectory(prefix="fuzz-") as folder,
        shared.open("r+b") as file,
    ):
        run, progress = (TARGETS | PLANTED)[target](Path(folder)), _Progress(file.fileno())
        _limit_address_space()
        first, accepted = progress.number, progress.accepted
        with suppress(BaseException):  # once for the compiler, which would count as a hang
            run(rng_of(seed, first))
        for number in range(first, inputs):

            def found(what: str, details: str, number: int = number) -> None:
                print(number, what, details.replace("\n", "\\n").replace("\t", " "), sep="\t", file=told, flush=True)

            Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
            before, began = _peak_bytes(), time.process_time()
            try:
                run(rng_of(seed, number))
                accepted += 1
            except RejectedError:
                pass
            except BaseException as error:
                found(_name_of(error), "".join(traceback.format_exception(error)))
            took, grown = time.process_time() - began, _peak_bytes() - before
            if took > hang_s:
                found("hang", f"{took:.1f} s")
            if grown > MOST_BYTES:
                found("memory", f"{grown / 1e9:.2f} GB")
            progress.tell(number + 1, accepted)


def _name_of(error: BaseException) -> str:
    """The type of an exception, and the line of this program that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not {"tests", "site-packages"} & set(Path(frame.filename).parts)]
    at = (own or frames)[-1]
    return f"{type(error).__name__} in {Path(at.filename).name}:{at.lineno}"


def _limit_address_space() -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _GUARD_BYTES, used + _GUARD_BYTES))


def _peak_bytes() -> int:
    status = Path("/proc/self/status").read_text()
    return 1024 * int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))


def main() -> int:
    """The command line: `python -m tests.fuzz [TARGET …] [--seconds S] [--inputs N] [--seed S]`."""
    if sys.argv[1:2] == ["--worker"]:
        target, seed, inputs, shared, hang_s = sys.argv[2:]
        work(target, int(seed), int(inputs), Path(shared), float(hang_s))
        return 0
    from tests.fuzz.targets import TARGETS

    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("target", nargs="*", default="all", choices=[*TARGETS, "all"], metavar="TARGET")
    parser.add_argument("--seconds", type=float, default=600.0, help="for each target (default: %(default)s)")
    parser.add_argument("--inputs", type=int, default=50_000, help="for each target (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    failed = False
    for target in TARGETS if "all" in args.target else args.target:
        outcome = fuzz(target, seed=args.seed, inputs=args.inputs, seconds=args.seconds)
        print(f"{target}: {outcome.inputs:,} inputs, {outcome.accepted:,} accepted, {len(outcome.findings)} findings")
        for finding in outcome.findings:
            failed = True
            print(
                f"  {outcome.kinds[finding.what]} × {finding.what}, first at --seed {args.seed} number {finding.number}"
            )
            print("    " + finding.details.replace("\\n", "\n    "))
        sys.stdout.flush()
    return int(failed)
