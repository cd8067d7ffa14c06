"""Reconstruct many captures side by side, and tell of all in one table."""

from argparse import Namespace
from contextlib import ExitStack
from typing import TYPE_CHECKING

from scanner.errors import InputError
from scanner.shown_text import harmless, shown
from scanner.ui import Terminal

if TYPE_CHECKING:
    from distributed import Client


def run(args: Namespace) -> None:
    """Do the work. Raises InputError."""
    from scanner.batch import (
        Asked,
        Batch,
        ClusterOptions,
        client_of,
        described,
        list_jobs,
        refuse_no_memory,
        require_dask,
        run_batch,
    )

    require_dask()
    if args.scheduler and (args.workers or args.memory):
        raise InputError("--workers and --memory are for this machine; a scheduler has its workers: give one of them")
    if args.workers is not None and args.workers < 1:
        raise InputError(f"--workers: expected 1 or more, found {args.workers}")
    if args.memory is not None:
        refuse_no_memory(args.memory)
    terminal = Terminal(quiet=args.quiet)
    if harmless(args.out) != args.out:
        raise InputError(f"--out: expected a name of characters that can be shown, in UTF-8, found {shown(args.out)}")
    asked = Asked(args.config, tuple(args.set), args.calibration)
    asked.refuse_no_calibration()
    with terminal.step("Looking for captures"):
        jobs = list_jobs(args.sources, asked)
    with ExitStack() as opened:

        def start() -> "Client":
            with terminal.step("Starting the workers"):
                client = opened.enter_context(client_of(ClusterOptions(args.scheduler, args.workers, args.memory)))
            terminal.show(described(client))
            return client

        found: Batch = run_batch(jobs, args.out, start, terminal, retry=args.retry)
    told = ", ".join(f"{count:,} with exit code {code}" for code, count in sorted(found.counts.items()))
    fresh = len(found.rows) - found.kept
    rate = f", {fresh / found.seconds:.2g} a second" if fresh else ""
    terminal.show(
        f"{len(found.rows):,} captures ({found.kept:,} of them done before): {told}",
        f"{found.seconds:.1f} s{rate}",
        f"Result: {args.out} (index.html, batch.parquet, batch.csv)",
    )
