"""Batch work that kills its own process, like a crash in a library or the out-of-memory killer."""

import os
import signal
from pathlib import Path

from scanner.batch import BatchJob, BatchRow, Delivery, work

POISON, ONCE = "poison", "once"


def deadly_work(job: BatchJob, delivery: Delivery) -> BatchRow:
    """`work`, except that a capture named 'poison' always kills the process, and one named 'once' the first time."""
    mark = Path(delivery.out) / "died"
    if POISON in job.name or (ONCE in job.name and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return work(job, delivery)
