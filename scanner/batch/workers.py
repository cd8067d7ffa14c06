"""What decodes the captures of a batch: processes of this computer, one per processor, or the workers of a running Dask
scheduler, which may be on many machines.

A process is restarted if it dies or exceeds its share of the memory.
"""

import contextlib
import logging
import multiprocessing
import os
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

from hw.optional_parts import BATCH
from scanner.batch.listing import BatchJob
from scanner.batch.rows import BatchRow
from scanner.batch.work import Delivery, Work
from scanner.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

# A capture that was running when this many processes died is assumed to kill them.
DEATHS = 3
# Interval of memory checks, and the largest multiple of its share that a process may use.
_LOOK_S, _ALLOWED = 0.5, 0.95
# Threads of libraries would compete with each other.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_REACHED_WITHIN_S = 20


class WorkerDiedError(Exception):
    """The processes that worked on a capture were killed, each time that it was tried."""

    def __str__(self) -> str:
        return "the processes that worked on it were killed: out of memory, or a crash in a library"


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    job: BatchJob | None = None

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


class Processes(contextlib.AbstractContextManager["Processes"]):
    """`count` of them (None: one for each processor), of `memory_bytes` each (None: an equal share of what there is),
    for as long as the context lasts.
    """

    def __init__(self, count: int | None = None, memory_bytes: float | None = None) -> None:
        self._count = count or os.cpu_count() or 1
        self._memory_bytes = memory_bytes or _all_memory() / self._count
        self._workers: list[_Worker] = []

    def __exit__(self, *_: object) -> None:
        while self._workers:
            self._workers.pop().end()

    def __str__(self) -> str:
        many = f"{self._count} process{'' if self._count == 1 else 'es'}"
        return f"{many} of {self._memory_bytes / 2**30:.1f} GiB each"

    def results(
        self, work: Work, jobs: Iterable[BatchJob], delivery: Delivery
    ) -> Iterator[tuple[BatchJob, BatchRow | Exception]]:
        """The outcome of each job, in the order in which they finish."""
        waiting, deaths = list(jobs)[::-1], dict[str, int]()
        while waiting or any(worker.job for worker in self._workers):
            self._distribute(work, waiting, delivery)
            self._end_the_largest()
            for ready in wait([worker.connection for worker in self._workers if worker.job], _LOOK_S):
                worker = next(worker for worker in self._workers if worker.connection is ready)
                job, worker.job = worker.job, None
                assert job is not None
                try:
                    outcome = worker.connection.recv()
                except (EOFError, ConnectionError):
                    self._workers.remove(worker)
                    worker.end()
                    deaths[job.name] = deaths.get(job.name, 0) + 1
                    if deaths[job.name] < DEATHS:
                        waiting.append(job)
                        continue
                    outcome = WorkerDiedError()
                yield job, outcome

    def _distribute(self, work: Work, waiting: list[BatchJob], delivery: Delivery) -> None:
        while len(self._workers) < min(self._count, len(waiting) + len(self._workers)):
            self._workers.append(_started())
        for worker in self._workers:
            if waiting and worker.job is None:
                worker.job = waiting.pop()
                with contextlib.suppress(ConnectionError):  # it has died, which the reader notices
                    worker.connection.send((work, worker.job, delivery))

    def _end_the_largest(self) -> None:
        for worker in self._workers:
            if _memory_of(worker.process.pid) > _ALLOWED * self._memory_bytes:
                worker.process.kill()


def _started() -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        process = context.Process(target=_serve, args=(theirs,), daemon=True)
        process.start()
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    theirs.close()
    return _Worker(process, ours)


def _serve(connection: Connection) -> None:
    """Run one job after another in a worker process until its connection closes."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # a signal of the terminal; the batch ends its processes itself
    while True:
        try:
            work, job, delivery = connection.recv()
        except EOFError:
            return
        outcome: BatchRow | Exception
        try:
            outcome = work(job, delivery)
        except Exception as error:
            outcome = error
        connection.send(outcome)


def _all_memory() -> float:
    """Bytes of memory of this machine, or the limit of a container."""
    limits = [float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))]
    with contextlib.suppress(OSError, ValueError):  # no such limit, or the value "max"
        limits.append(float(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return min(limits)


def _memory_of(pid: int | None) -> float:
    """Bytes that a process has in memory now; 0 on systems other than Linux."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    except (OSError, IndexError):
        return 0.0
    return float(int(pages) * os.sysconf("SC_PAGE_SIZE"))


class DaskWorkers:
    """The workers of a scheduler that a client is connected with. Dask moves work off workers that die."""

    def __init__(self, client: "Client") -> None:
        self._client = client

    def results(
        self, work: Work, jobs: Iterable[BatchJob], delivery: Delivery
    ) -> Iterator[tuple[BatchJob, BatchRow | Exception]]:
        """The outcome of each job, in the order in which they finish.

        At most one task per thread is submitted at a time. Of more, Dask would also blame the waiting ones for a
        worker's death, and a million would fill the scheduler's memory.
        """
        from distributed import KilledWorker, as_completed

        waiting, run = iter(jobs), uuid4().hex
        of_future: dict[str, BatchJob] = {}
        running = as_completed()

        def fill() -> None:
            threads = max(1, sum(self._client.nthreads().values()))
            for job in islice(waiting, max(0, threads - len(of_future))):
                future = self._client.submit(work, job, delivery, key=f"{job.name}/{run}", pure=False)
                of_future[future.key] = job
                running.add(future)

        fill()
        for future in running:
            job = of_future.pop(future.key)
            fill()
            try:
                yield job, future.result()
            except KilledWorker:
                yield job, WorkerDiedError()
            except Exception as error:
                yield job, error

    def __str__(self) -> str:
        """Return the number of workers, their memory, and where to watch them."""
        workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        limits = sorted({worker["memory_limit"] for worker in workers})
        memory = " to ".join(f"{limit / 2**30:.1f} GiB" for limit in (limits[:1] + limits[1:][-1:])) or "no memory yet"
        many = f"{len(workers)} worker{'' if len(workers) == 1 else 's'}"
        return f"{many} of {memory} each; Dask's dashboard: {self._client.dashboard_link}"


def refuse_without_dask() -> None:
    """Raise InputError, saying what to install, if Dask is not there."""
    with BATCH.needed("--scheduler", "Dask", InputError):
        import distributed
    logging.getLogger(distributed.__name__).setLevel(logging.CRITICAL)


@contextmanager
def dask_workers(scheduler: str) -> Iterator[DaskWorkers]:
    """Workers of the scheduler at an address, for as long as the context lasts. Raises InputError if none answers."""
    from distributed import Client

    try:
        client = Client(scheduler, timeout=_REACHED_WITHIN_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"{scheduler}: no Dask scheduler answers within {_REACHED_WITHIN_S} s; start one with 'dask "
            "scheduler', and workers with 'dask worker ADDRESS --nthreads 1 --nworkers N'"
        ) from error
    with client:
        yield DaskWorkers(client)
