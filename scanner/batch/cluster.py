"""A running Dask scheduler, whose workers may be on many machines."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING
from uuid import uuid4

from hw.optional_parts import BATCH
from scanner.batch.listing import BatchJob
from scanner.batch.processes import WorkerDiedError
from scanner.batch.rows import BatchRow
from scanner.batch.work import Delivery, Work
from scanner.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

_REACHED_WITHIN_S = 20


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
