"""Overhead of a batch: throughput on one and two processes, on a scheduler, and of a second run.

    python benchmarks/bench_batch.py --captures 1000

The captures are copies of one of a simulated room, with half a second of work each. 'alone': the same work in a loop.
The overhead is the additional time of a capture on one worker. 'apart': a Dask scheduler and two workers, over
TCP. Keep the machine idle.
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scanner.batch import BatchJob, BatchRequest, DaskWorkers, Delivery, Processes, Workers, list_jobs, run_batch, work
from scanner.configuration import load_config
from scanner.jobs import scan
from scanner.ui import Terminal

_ROOM = (
    "rig={backend: simulated, seed: 0, furniture: false, interreflection: false, ambient: 0}",
    "camera={width: 306, height: 256, principal_point: {known: [157.04, 131.79]}}",
    "projector={width: 214, height: 120}",
    "corner={squareness_deg: 0}",
    "sequence={preset: quick}",
)
_ALONE = 40
# As in docs/scale.md: Dask's defaults return memory at once, which costs a quarter of the time.
_MEMORY = {"MALLOC_TRIM_THRESHOLD_": "268435456", "MALLOC_MMAP_THRESHOLD_": "33554432"}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--captures", type=int, nargs="+", default=[100])
    asked = options.parse_args()
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        recording = _recorded(folder)
        for count in asked.captures:
            _measure(folder / str(count), recording, count)


def _measure(folder: Path, recording: Path, count: int) -> None:
    for number in range(count):
        shutil.copytree(recording, folder / "captures" / f"{number:06}", copy_function=os.link)
    began_s = time.perf_counter()
    jobs = list_jobs([str(folder / "captures")], BatchRequest(overrides=_ROOM[1:4]))
    print(f"\n{count} captures, found in {time.perf_counter() - began_s:.2f} s")
    alone = _seconds_each_alone(jobs[:_ALONE], folder / "alone")
    print(f"alone, in a loop: {1000 * alone:.0f} ms a capture")
    rates = {}
    for workers in (1, 2):
        with Processes(workers) as processes:
            run_batch(jobs[:workers], str(folder / f"warm-{workers}"), lambda: processes, Terminal(quiet=True))
            rates[workers] = _rate(jobs, folder / f"on-{workers}", processes)
        print(f"{workers} worker{'s' * (workers > 1)}: {rates[workers]:.2f} captures a second")
    print(f"two workers against one: {rates[2] / rates[1]:.2f} (limit: at least 1.8)")
    print(f"overhead of one worker: {1000 * (1 / rates[1] - alone):.0f} ms a capture (limit: 20)")
    with _apart() as client:
        _warm(client, jobs[0], folder / "warm", 2)
        rate = _rate(jobs, folder / "apart", DaskWorkers(client))
        print(f"scheduler and two separate workers: {rate:.2f} a second, {rate / rates[2]:.2f} of two processes here")
    command = [
        sys.executable,
        "-m",
        "scanner",
        "batch",
        str(folder / "captures"),
        "--out",
        str(folder / "on-2"),
        "--quiet",
    ]
    began_s = time.perf_counter()
    subprocess.run([*command, *(word for key in _ROOM[1:4] for word in ("--set", key))], check=True)
    print(f"second run, as a command: {time.perf_counter() - began_s:.1f} s (limit: 5)")


def _recorded(folder: Path) -> Path:
    scan(load_config(None, _ROOM), folder / "room")
    return folder / "room" / "capture"


def _seconds_each_alone(jobs: tuple[BatchJob, ...], out: Path) -> float:
    work(jobs[0], Delivery(str(out / "first")))
    began_s = time.perf_counter()
    for job in jobs:
        work(job, Delivery(str(out)))
    return (time.perf_counter() - began_s) / len(jobs)


def _warm(client: Any, job: BatchJob, out: Path, workers: int) -> None:
    """Make every worker load all modules."""
    client.wait_for_workers(workers)
    addresses = list(client.scheduler_info(n_workers=-1)["workers"])
    client.gather(
        [
            client.submit(work, job, Delivery(f"{out}-{number}"), workers=[address], pure=False)
            for number, address in enumerate(addresses)
        ]
    )


def _rate(jobs: tuple[BatchJob, ...], out: Path, workers: Workers) -> float:
    began_s = time.perf_counter()
    found = run_batch(jobs, str(out), lambda: workers, Terminal(quiet=True))
    seconds = time.perf_counter() - began_s
    assert found.counts == {0: len(jobs)}, found.counts
    return len(jobs) / seconds


@contextmanager
def _apart() -> Iterator[Any]:
    from distributed import Client

    with TemporaryDirectory() as scratch, ExitStack() as processes:
        file = Path(scratch) / "scheduler.json"

        def start(*command: str) -> None:
            environment = {**os.environ, **_MEMORY}
            command = (sys.executable, "-m", *command, "--no-dashboard")
            process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=environment)
            processes.callback(process.wait)
            processes.callback(process.kill)

        start("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        for _ in range(2):
            start("distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1")
        with Client(scheduler_file=str(file), timeout=60) as client:
            yield client


if __name__ == "__main__":
    main()
