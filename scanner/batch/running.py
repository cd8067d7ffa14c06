"""A batch from the first capture to the table."""

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING
from uuid import uuid4

from scanner.batch.listing import Job
from scanner.batch.page import write_page
from scanner.batch.place import Place
from scanner.batch.rows import ENDING, Row
from scanner.batch.table import write_csv, write_parquet
from scanner.batch.work import ROWS, Delivery, work
from scanner.errors import is_of_the_disk
from scanner.ui import EXIT_BUG, Progress

if TYPE_CHECKING:
    from distributed import Client

log = logging.getLogger(__name__)

TABLE, CSV, PAGE = "batch.parquet", "batch.csv", "index.html"


@dataclass(frozen=True)
class Batch:
    """`rows` by name, those `kept` of earlier runs included; `seconds` of this run."""

    rows: tuple[Row, ...]
    kept: int
    seconds: float

    @property
    def counts(self) -> Counter[int]:
        """How many captures came to which exit code."""
        return Counter(row.exit_code for row in self.rows)


def pending(jobs: Sequence[Job], out: Place, *, retry: bool) -> tuple[dict[str, Row], list[Job]]:
    """Rows that earlier runs of the batch left for what is asked, and the jobs that have none.

    `retry`: what crashed is tried again. Raises InputError for a row that is none.
    """
    found = {name: Row.from_json(data, f"{name}{ENDING}") for name, data in (out / ROWS).read_all(ENDING).items()}
    asked = {job.name: job.asked for job in jobs}
    kept = {
        name: row
        for name, row in found.items()
        if asked.get(name) == row.asked and not (retry and row.exit_code == EXIT_BUG)
    }
    return kept, [job for job in jobs if job.name not in kept]


def run_batch(
    jobs: Sequence[Job],
    out: str,
    client: Callable[[], "Client"] | None,
    progress: Progress,
    *,
    retry: bool = False,
) -> Batch:
    """Work on what no earlier run has finished, and write the table of all. `client` is asked for if there is work.

    Raises InputError, StorageError, OSError; what a capture does is in its row.
    """
    began_s = time.monotonic()
    delivery = Delivery(out)
    rows, to_do = pending(jobs, Place(out), retry=retry)
    kept = len(rows)
    if to_do and client is not None:
        for row in progress.track(_worked(to_do, delivery, client()), len(to_do), "Captures"):
            rows[row.name] = row
    found = tuple(rows[name] for name in sorted(rows))
    with progress.step("Writing the table"):
        write_parquet(Place(out) / TABLE, found)
        write_csv(Place(out) / CSV, found)
        write_page(Place(out) / PAGE, found)
    return Batch(found, kept, time.monotonic() - began_s)


def _worked(jobs: Sequence[Job], delivery: Delivery, client: "Client") -> Iterator[Row]:
    """Rows as they are finished. Dask moves work off workers that die, and gives up what ends them.

    There are as many tasks at a time as threads to work on them: with more, Dask would also blame those for a worker's
    death that were waiting there, and a million would fill the scheduler's memory.
    """
    from distributed import as_completed

    waiting, run = iter(jobs), uuid4().hex
    of_future: dict[str, Job] = {}
    running = as_completed()

    def fill() -> None:
        threads = max(1, sum(client.nthreads().values()))
        for job in islice(waiting, max(0, threads - len(of_future))):
            future = client.submit(work, job, delivery, key=f"{job.name}/{run}", pure=False)
            of_future[future.key] = job
            running.add(future)

    fill()
    for future in running:
        job = of_future.pop(future.key)
        fill()
        try:
            yield future.result()
        except Exception as error:
            if is_of_the_disk(error):
                error.add_note("What was finished is kept: once there is room, the same command goes on from there.")
                raise
            yield _crashed(job, delivery, error)


def _crashed(job: Job, delivery: Delivery, error: Exception) -> Row:
    from distributed import KilledWorker

    reason = f"{type(error).__name__}: {error}"
    if isinstance(error, KilledWorker):
        reason = "the processes that worked on it were killed: out of memory, or a crash in a library"
    log.warning("%s: %s", job.name, reason)
    url = delivery.result(job.name).url
    row = Row(job.name, job.capture, url, EXIT_BUG, reason=reason, asked=job.asked)
    delivery.row(job.name).write(row.to_json())
    return row
