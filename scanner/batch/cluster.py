"""Where a batch is worked on: processes of this machine, or any Dask scheduler."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scanner.errors import InputError
from scanner.shown_text import shown

if TYPE_CHECKING:
    from distributed import Client

MISSING_DASK = (
    "batches need Dask, which is not installed: .venv/bin/pip install '.[batch]' in the program's folder, on the "
    "machines of the scheduler and of all workers as well"
)
# A capture that was there when so many workers died is what ends them.
_DEATHS = 3
_REACHED_WITHIN_S = 20
# With less, a worker is killed over the smallest capture.
_LEAST_BYTES = 400_000_000
_SETTINGS = {
    "distributed.scheduler.allowed-failures": _DEATHS - 1,
    # Dask would also have workers give memory back at once (MALLOC_TRIM_THRESHOLD_), which costs a quarter of the time
    # here: images of the same size come and go.
    "distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1, "MKL_NUM_THREADS": 1},
    "distributed.worker.profile.enabled": False,
}


@dataclass(frozen=True)
class ClusterOptions:
    """`scheduler`: the address of a running one; without it, `workers` processes of this machine (None: one for each
    processor), of `memory` each, as in 4GB (None: an equal share of what there is).
    """

    scheduler: str | None = None
    workers: int | None = None
    memory: str | None = None


def require_dask() -> None:
    """Raise InputError, saying what to install, if Dask is not there."""
    try:
        import distributed
        import fsspec  # noqa: F401
    except ImportError as error:
        raise InputError(MISSING_DASK) from error
    logging.getLogger(distributed.__name__).setLevel(logging.CRITICAL)


def refuse_no_memory(size: str) -> None:
    """Raise InputError if a size is none, or no worker could live with it."""
    from dask.utils import parse_bytes

    try:
        enough = parse_bytes(size) >= _LEAST_BYTES
    except (ValueError, OverflowError):
        enough = False
    if not enough:
        least = f"{_LEAST_BYTES / 1e6:.0f}MB"
        raise InputError(f"--memory: expected a size of {least} or more, as in 4GB, found {shown(size)}")


@contextmanager
def client_of(options: ClusterOptions) -> Iterator["Client"]:
    """A client of the scheduler for as long as the context lasts. Raises InputError if it cannot be reached."""
    import dask
    from distributed import Client, LocalCluster

    if options.scheduler is not None:
        try:
            client = Client(options.scheduler, timeout=_REACHED_WITHIN_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"{options.scheduler}: no Dask scheduler answers within {_REACHED_WITHIN_S} s; start one with 'dask "
                "scheduler', and workers with 'dask worker ADDRESS --nthreads 1 --nworkers N'"
            ) from error
        with client:
            yield client
        return
    with (
        dask.config.set(_SETTINGS),
        LocalCluster(
            n_workers=options.workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=options.memory or "auto",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def described(client: "Client") -> str:
    """How many workers there are, of how much memory, and where to watch them."""
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    limits = sorted({worker["memory_limit"] for worker in workers})
    memory = " to ".join(f"{limit / 2**30:.1f} GiB" for limit in (limits[:1] + limits[1:][-1:])) or "no memory yet"
    many = f"{len(workers)} worker{'' if len(workers) == 1 else 's'}"
    return f"{many} of {memory} each; Dask's dashboard: {client.dashboard_link}"
