"""Many captures, on all processors of this machine or, through Dask, of many; a row of a table for each."""

from scanner.batch.listing import BatchJob, BatchRequest, list_jobs
from scanner.batch.rows import BatchRow
from scanner.batch.running import Batch, Workers, run_batch
from scanner.batch.work import Delivery, work
from scanner.batch.workers import DaskWorkers, Processes, dask_workers, refuse_without_dask
