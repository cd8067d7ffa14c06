"""A batch from the first capture to the table, and its page: a picture and a line for each capture, to be filtered."""

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from math import inf, isfinite
from pathlib import Path
from typing import Protocol
from urllib.parse import quote

from scanner.batch.listing import BatchJob
from scanner.batch.location import Location
from scanner.batch.rows import ENDING, BatchRow, write_csv, write_parquet
from scanner.batch.work import RESULTS, ROWS, THUMBNAILS, Delivery, Work, work
from scanner.batch.workers import WorkerDiedError
from scanner.errors import cannot_write, is_of_the_disk
from scanner.quantities import Quantity
from scanner.rendering import page
from scanner.results import REPORT_FILE, SIGNS, Claim, FolderState
from scanner.ui import EXIT_BUG, EXIT_INPUT, EXIT_REFUSED, Progress

_SCRIPT = "batch.js"
# More rows would be slow in a browser; the table has all.
_MOST_ROWS = 5_000
_WORDS = {0: "calibrated", EXIT_INPUT: "unusable input", EXIT_REFUSED: "refused", EXIT_BUG: "crashed"}
log = logging.getLogger(__name__)

_RUNNING = ".batch-running"  # in the folder, while a batch writes there
TABLE, CSV, PAGE = "batch.parquet", "batch.csv", "index.html"


def write_page(place: Location, rows: Sequence[BatchRow]) -> None:
    """Write the page. It needs no network; it links to the results and to no other files. Raises OSError."""
    counts = Counter(_state(row) for row in rows)
    text = page(
        "batch.html",
        lines=[_line(row) for row in rows[:_MOST_ROWS]],
        total=len(rows),
        left_out=max(0, len(rows) - _MOST_ROWS),
        counts=sorted(counts.items()),
        runs=_SCRIPT,
    )
    place.write(text.encode())


def _line(row: BatchRow) -> dict[str, object]:
    name = quote(row.name)
    return {
        "name": row.name,
        "state": _state(row),
        "grade": row.grade or "refused",
        "headline": _headline(row),
        "reason": row.reason or "",
        "report": f"{RESULTS}/{name}/{REPORT_FILE}" if row.grade else None,
        "picture": f"{THUMBNAILS}/{name}.jpg" if row.exit_code != EXIT_BUG else None,
        "camera": _with_sigma(row.camera_focal_px, row.camera_focal_sigma_px),
        "projector": _with_sigma(row.projector_focal_px, row.projector_focal_sigma_px),
        "residual": "" if row.residual_px is None else f"{row.residual_px:.3f}",
        "seconds": f"{row.seconds:.1f}",
    }


def _headline(row: BatchRow) -> str:
    if row.headline is None:
        return _state(row).capitalize()
    return f"{SIGNS[row.grade or 'refused']} {row.headline}"


def _state(row: BatchRow) -> str:
    return _WORDS.get(row.exit_code, f"exit code {row.exit_code}")


def _with_sigma(value: float | None, sigma: float | None) -> str:
    if value is None or not isfinite(value):
        return ""
    known = sigma if sigma is not None and 0 < sigma < inf else None
    quantity = Quantity("", value, "px", known)
    return quantity.shown(value) + (f" ± {quantity.shown(known)}" if known else "")


class Workers(Protocol):
    """Workers that run jobs in parallel."""

    def results(
        self, work: Work, jobs: Iterable[BatchJob], delivery: Delivery
    ) -> Iterator[tuple[BatchJob, BatchRow | Exception]]:
        """What `work` made of each job, or the error that it ended with, in the order in which they are finished."""


@dataclass(frozen=True)
class Batch:
    """`rows` by name, with those `kept` from earlier runs; `seconds` of this run; `files` that summarise all rows."""

    rows: tuple[BatchRow, ...]
    kept: int
    seconds: float
    files: tuple[str, ...]

    @property
    def counts(self) -> Counter[int]:
        """Count the captures per exit code."""
        return Counter(row.exit_code for row in self.rows)


def pending(jobs: Sequence[BatchJob], out: Location, *, retry: bool) -> tuple[dict[str, BatchRow], list[BatchJob]]:
    """Rows of earlier runs for the same requests, and the jobs without a row.

    `retry`: crashed jobs run again. Raises InputError for an invalid row.
    """
    rows = {name: BatchRow.from_json(data, f"{name}{ENDING}") for name, data in (out / ROWS).read_all(ENDING).items()}
    asked = {job.name: job.asked for job in jobs}
    kept = {
        name: row
        for name, row in rows.items()
        if asked.get(name) == row.asked and not (retry and row.exit_code == EXIT_BUG)
    }
    return kept, [job for job in jobs if job.name not in kept]


def run_batch(
    jobs: Sequence[BatchJob],
    out: str,
    workers: Callable[[], Workers] | None,
    progress: Progress,
    *,
    retry: bool = False,
) -> Batch:
    """Work on jobs that no earlier run has finished, and write the table of all. `workers` are started only if needed.

    Raises InputError, also if another batch writes there, StorageError, OSError; a capture's outcome is in its row.
    """
    with _alone_in(Location(out)):
        return _run(jobs, out, workers, progress, retry=retry)


@contextmanager
def _alone_in(out: Location) -> Iterator[None]:
    """No other batch works for this folder of this machine: it would find half a result, and say so in the table.

    Raises InputError, StorageError.
    """
    if (folder := out.local) is None:  # file systems of the network have no locks
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        claim = _claim(folder / _RUNNING)
    except OSError as error:
        raise cannot_write(out.url, error) from error
    try:
        claim.say(FolderState.LIVE)
        yield
    finally:
        claim.path.unlink(missing_ok=True)
        claim.release()
        with suppress(OSError):
            folder.rmdir()  # nothing was written


def _claim(lock: Path) -> Claim:
    claim = Claim(lock, make=True, maker="batch", remove=lock)
    while not claim.is_current:  # the one before has just ended, and removed it
        claim.release()
        claim = Claim(lock, make=True, maker="batch", remove=lock)
    return claim


def _run(
    jobs: Sequence[BatchJob], out: str, workers: Callable[[], Workers] | None, progress: Progress, *, retry: bool
) -> Batch:
    """`run_batch`, alone in its folder."""
    began_s = time.monotonic()
    delivery = Delivery(out)
    rows, to_do = pending(jobs, Location(out), retry=retry)
    kept = len(rows)
    if to_do and workers is not None:
        for row in progress.track(_worked(to_do, delivery, workers()), len(to_do), "Captures"):
            rows[row.name] = row
    ordered = tuple(rows[name] for name in sorted(rows))
    tables = {PAGE: write_page, CSV: write_csv}
    if find_spec("pyarrow") is not None:  # part of the extra 'batch'
        tables[TABLE] = write_parquet
    with progress.step("Writing the table"):
        for name, write in tables.items():
            write(Location(out) / name, ordered)
    return Batch(ordered, kept, time.monotonic() - began_s, tuple(tables))


def _worked(jobs: Sequence[BatchJob], delivery: Delivery, workers: Workers) -> Iterator[BatchRow]:
    """Rows in the order of completion."""
    for job, outcome in workers.results(work, jobs, delivery):
        if isinstance(outcome, BatchRow):
            yield outcome
        elif is_of_the_disk(outcome):
            outcome.add_note("What was finished is kept: once there is room, the same command goes on from there.")
            raise outcome
        else:
            yield _crashed(job, delivery, outcome)


def _crashed(job: BatchJob, delivery: Delivery, error: Exception) -> BatchRow:
    reason = str(error) if isinstance(error, WorkerDiedError) else f"{type(error).__name__}: {error}"
    log.warning("%s: %s", job.name, reason)
    url = delivery.result(job.name).url
    row = BatchRow(job.name, job.capture, url, EXIT_BUG, reason=reason, asked=job.asked)
    delivery.row(job.name).write(row.to_json())
    return row
