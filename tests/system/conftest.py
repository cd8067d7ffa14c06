"""What several files of this folder share."""

from collections.abc import Iterator

import pytest

from tests.support.fault_bench import FaultBench


@pytest.fixture(scope="session")
def bench() -> Iterator[FaultBench]:
    """The process that scans, whose start takes seconds; its tests run in one group for that."""
    with FaultBench() as bench:
        yield bench
