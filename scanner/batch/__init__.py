"""Many captures, on all processors of this machine or of many, through Dask; a row of a table for each."""

from scanner.batch.cluster import ClusterOptions, client_of, described, refuse_no_memory, require_dask
from scanner.batch.listing import Asked, list_jobs
from scanner.batch.running import Batch, run_batch
