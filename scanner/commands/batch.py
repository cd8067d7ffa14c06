"""Reconstruct many captures in parallel, and summarise them in one table."""

import re
from contextlib import ExitStack
from typing import TYPE_CHECKING

from scanner.commands.command import is_enough
from scanner.commands.options_of_scans import BatchCommand
from scanner.errors import GradeError, InputError
from scanner.shown_text import harmless, shown
from scanner.ui import Terminal

if TYPE_CHECKING:
    from scanner.batch import DaskWorkers, Processes

_SIZE = re.compile(r"(\d{1,6}(?:\.\d{1,3})?) ?([MGT])(i?)B?", re.ASCII | re.IGNORECASE)
# With less, a process would be ended by the smallest capture.
_LEAST_BYTES = 400_000_000
_NAMED = 5  # captures that a message names


def run(args: BatchCommand) -> None:
    """Do the work. Raises InputError, GradeError."""
    from scanner.batch import Batch, BatchRequest, Processes, dask_workers, list_jobs, refuse_without_dask, run_batch

    if args.scheduler:
        refuse_without_dask()
        if args.workers or args.memory:
            raise InputError("--workers and --memory are for this machine; a scheduler has its own: give one of them")
    if args.workers is not None and args.workers < 1:
        raise InputError(f"--workers: expected 1 or more, found {args.workers}")
    memory_bytes = None if args.memory is None else _bytes(args.memory)
    terminal = Terminal(quiet=args.quiet)
    if harmless(args.out) != args.out:
        raise InputError(f"--out: expected a name of printable UTF-8 characters, found {shown(args.out)}")
    asked = BatchRequest(args.settings.config, tuple(args.settings.set), args.calibration)
    asked.refuse_no_calibration()
    with terminal.step("Looking for captures"):
        jobs = list_jobs(args.sources, asked)
    with ExitStack() as opened:

        def start() -> "Processes | DaskWorkers":
            workers: Processes | DaskWorkers
            if args.scheduler:
                workers = opened.enter_context(dask_workers(args.scheduler))
            else:
                workers = opened.enter_context(Processes(args.workers, memory_bytes))
            terminal.show(str(workers))
            return workers

        batch: Batch = run_batch(jobs, args.out, start, terminal, retry=args.retry)
    counts = ", ".join(f"{count:,} with exit code {code}" for code, count in sorted(batch.counts.items()))
    fresh = len(batch.rows) - batch.kept
    rate = f", {fresh / batch.seconds:.2g} a second" if fresh else ""
    terminal.show(
        f"{len(batch.rows):,} captures ({batch.kept:,} of them done before): {counts}",
        f"{batch.seconds:.1f} s{rate}",
        f"Result: {args.out} ({', '.join(batch.files)})",
        f"→ Open {args.out.rstrip('/')}/{batch.files[0]} in a browser: a line for each capture, with its report.",
    )
    lower = [row.name for row in batch.rows if not is_enough(row.grade, args.require)]
    if lower:
        some = f"{', '.join(lower[:_NAMED])}{' …' if len(lower) > _NAMED else ''}"
        raise GradeError(
            f"{len(lower):,} of {len(batch.rows):,} captures are below {args.require}, which --require asks for: "
            f"{shown(some)}; all results are kept"
        )


def _bytes(size: str) -> float:
    match = _SIZE.fullmatch(size.strip())
    if match:
        number, unit, binary = match.groups()
        size_bytes: float = float(number) * (1024 if binary else 1000) ** (" KMGT".index(unit.upper()))
        if size_bytes >= _LEAST_BYTES:
            return size_bytes
    least = f"{_LEAST_BYTES / 1e6:.0f}MB"
    raise InputError(f"--memory: expected a size of {least} or more, as in 4GB, found {shown(size)}")
