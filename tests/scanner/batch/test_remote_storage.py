"""Batches with remote captures and results: in memory, and in a bucket of a local S3 server."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib.numerics import use_processors
from scanner.batch.listing import BatchRequest, list_jobs
from scanner.batch.location import Location
from scanner.batch.running import run_batch
from scanner.batch.workers import DaskWorkers
from scanner.ui import Terminal

fsspec = pytest.importorskip("fsspec", reason="stores that are far away need the extra 'batch'")
pytest.importorskip("distributed")

pytestmark = pytest.mark.xdist_group("batch")

QUIET = Terminal(quiet=True)


@pytest.fixture
def bucket() -> Iterator[str]:
    server_of = pytest.importorskip("moto.server", reason="an S3 server for tests")
    pytest.importorskip("s3fs", reason="s3:// needs s3fs")
    server = server_of.ThreadedMotoServer(port=0)
    server.start()
    host, port = server.get_host_and_port()
    before = dict(fsspec.config.conf)
    fsspec.config.conf["s3"] = {"endpoint_url": f"http://{host}:{port}", "key": "test", "secret": "test"}
    system, _ = fsspec.url_to_fs("s3://museum")
    system.mkdir("museum")
    yield "s3://museum"
    fsspec.config.conf.clear()
    fsspec.config.conf.update(before)
    server.stop()


@pytest.fixture
def memory() -> Iterator[str]:
    yield "memory://museum"
    fsspec.filesystem("memory").store.clear()


@pytest.mark.parametrize("where", ["memory", "bucket"])
def test_captures_and_results_in_remote_storage(where: str, museum: Path, request: pytest.FixtureRequest) -> None:
    from distributed import Client

    root = request.getfixturevalue(where)
    system, path = fsspec.url_to_fs(root)
    system.put(f"{museum / 'captures/hall/one'}/", f"{path}/captures/hall/one/", recursive=True)
    system.pipe_file(f"{path}/captures/broken/capture.yaml", b"format: 1")
    jobs = list_jobs([f"{root}/captures"], BatchRequest(museum / "room.yaml"))
    assert [(job.name, job.capture) for job in jobs] == [
        ("broken", f"{root.replace('memory://', 'memory:///')}/captures/broken"),
        ("hall/one", f"{root.replace('memory://', 'memory:///')}/captures/hall/one"),
    ]
    # Threads of this process: what is in its memory is in no other.
    with Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        found = run_batch(jobs, f"{root}/out", lambda: DaskWorkers(client), QUIET)
    use_processors(os.cpu_count() or 1)
    assert [(row.name, row.exit_code) for row in found.rows] == [("broken", 2), ("hall/one", 0)]
    for name in ("index.html", "batch.csv", "batch.parquet", "rows/hall/one.json", "thumbnails/hall/one.jpg"):
        assert len((Location(root) / "out" / name).read()) > 100
    delivered = Location(root) / "out/results/hall/one"
    assert {Path(file).name for file in system.find(f"{path}/out/results/hall/one")} >= {"cloud.ply", "report.html"}
    local = (museum / "scans/one/calibration.yaml").read_text().partition("made:")[0]
    assert (delivered / "calibration.yaml").read().decode().startswith(local)
    assert run_batch(jobs, f"{root}/out", None, QUIET).kept == 2
