"""Batches of small captures, on local workers and on a scheduler: outcomes and tables."""

import csv
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import pytest

from hw.optional_parts import BATCH
from scanner.batch import running as running_module
from scanner.batch.listing import BatchJob, BatchRequest, list_jobs
from scanner.batch.rows import BatchRow
from scanner.batch.running import CSV, PAGE, TABLE, run_batch
from scanner.batch.work import Delivery, Work
from scanner.batch.workers import Processes, dask_workers
from scanner.commands import main
from scanner.errors import StorageError
from scanner.io import read_calibration
from scanner.ui import Terminal, failure_of
from tests.support.deadly_work import deadly_work
from tests.support.little_memory import no_file_larger_than
from tests.support.places import ROOT

pytestmark = pytest.mark.xdist_group("batch")

QUIET = Terminal(quiet=True)


@dataclass(frozen=True)
class Done:
    """A batch of all captures: its command, its folder, and what was said."""

    command: list[str]
    out: Path
    said: str


@pytest.fixture(scope="module")
def done(museum: Path, tmp_path_factory: pytest.TempPathFactory) -> Done:
    out, config = tmp_path_factory.mktemp("done") / "out", str(museum / "room.yaml")
    command = ["batch", str(museum / "captures"), "--config", config, "--out", str(out), "--workers", "2"]
    with redirect_stdout(StringIO()) as said:
        assert main(command) == 0
    return Done(command, out, said.getvalue())


def rows_of(out: Path) -> dict[str, dict[str, str]]:
    with (out / CSV).open(encoding="utf-8") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def timeless(out: Path) -> list[tuple[object, ...]]:
    parquet = pytest.importorskip("pyarrow.parquet", reason="tables as Parquet need the extra 'batch'")
    table = parquet.read_table(out / TABLE).drop_columns(["started", "seconds", "worker", "result"])
    return [tuple(row.items()) for row in table.to_pylist()]


def test_a_batch_from_the_command_line(done: Done, capsys: pytest.CaptureFixture[str]) -> None:
    out, said = done.out, done.said
    for words in ("2 processes of ", " GiB each", "4 captures (0 of them done before)", f"→ Open {out}/index.html"):
        assert words in said
    assert "2 with exit code 0, 1 with exit code 2, 1 with exit code 4" in said
    rows = rows_of(out)
    assert {name: (row["exit_code"], row["grade"]) for name, row in rows.items()} == {
        "broken": ("2", ""),
        "dark": ("4", "refused"),
        "hall/one": ("0", "fair"),
        "hall/two": ("0", "fair"),
    }
    assert "frames/000.png' is missing" in rows["broken"]["reason"]
    found = read_calibration(out / "results/hall/one/calibration.yaml")
    assert float(rows["hall/one"]["camera_focal_px"]) == found.camera.focal_px[0]
    assert not (out / "results/hall/one/capture").exists()
    assert (out / "results/dark/refused.yaml").is_file()
    page = (out / PAGE).read_text(encoding="utf-8")
    for name in ("hall/one", "dark"):
        assert f'href="results/{name}/report.html"' in page
        assert (out / "thumbnails" / f"{name}.jpg").stat().st_size > 500

    before = {path: path.stat().st_mtime_ns for path in (out / "results").rglob("*")}
    assert main(done.command) == 0
    assert "4 captures (4 of them done before)" in capsys.readouterr().out
    assert main([*done.command, "--require", "fair"]) == 4  # every row is there already
    assert "2 of 4 captures are below fair" in capsys.readouterr().err
    assert before == {path: path.stat().st_mtime_ns for path in (out / "results").rglob("*")}


def test_a_capture_that_kills_its_worker_fails_alone(
    museum: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures, out = tmp_path / "captures", tmp_path / "out"
    for name in ("a", "b-poison", "c-once"):
        shutil.copytree(museum / "captures" / "hall" / "one", captures / name)
    out.mkdir()
    jobs = list_jobs([str(captures)], BatchRequest(museum / "room.yaml"))
    monkeypatch.setattr(running_module, "work", deadly_work)
    with Processes(2) as processes:
        found = run_batch(jobs, str(out), lambda: processes, QUIET)
        assert [(row.name, row.exit_code) for row in found.rows] == [
            ("a", 0),
            ("b-poison", 70),
            ("c-once", 0),
        ]
        assert (
            found.rows[1].reason
            == "the processes that worked on it were killed: out of memory, or a crash in a library"
        )
        # It is not tried again, unless that is asked for.
        assert run_batch(jobs, str(out), None, QUIET).kept == 3
        monkeypatch.undo()
        again = run_batch(jobs, str(out), lambda: processes, QUIET, retry=True)
    assert (again.kept, [row.exit_code for row in again.rows]) == (2, [0, 0, 0])


def test_a_full_disk_ends_the_batch_without_a_row(museum: Path, tmp_path: Path) -> None:
    jobs = list_jobs([str(museum / "captures" / "dark")], BatchRequest(museum / "room.yaml"))
    with Processes(1) as processes:
        with no_file_larger_than(500), pytest.raises(StorageError) as caught:
            run_batch(jobs, str(tmp_path), lambda: processes, QUIET)
        failure = failure_of(caught.value)
        assert failure.exit_code == 3
        assert f"{tmp_path}/thumbnails/dark.jpg: cannot be written: File too large" in failure.message
        assert "the same command goes on from there" in failure.message
        assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    with Processes(1) as processes:
        again = run_batch(jobs, str(tmp_path), lambda: processes, QUIET)
    assert (again.kept, [row.exit_code for row in again.rows]) == (0, [4])


class Reentering:
    """Workers during whose work another batch begins in the same folder."""

    def __init__(self, command: list[str]) -> None:
        self._command = command
        self.ended: subprocess.CompletedProcess[str] | None = None

    def results(self, work: Work, jobs: Iterable[BatchJob], delivery: Delivery) -> Iterator[tuple[BatchJob, BatchRow]]:
        command = [sys.executable, "-m", "scanner", *self._command]
        self.ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        for job in jobs:
            yield job, work(job, delivery)


def test_a_second_batch_into_the_same_folder_is_refused(museum: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    config, capture = museum / "room.yaml", museum / "captures" / "dark"
    second = Reentering(["batch", str(capture), "--config", str(config), "--out", str(out), "--quiet"])
    first = run_batch(list_jobs([str(capture)], BatchRequest(config)), str(out), lambda: second, QUIET)
    assert second.ended is not None
    assert second.ended.returncode == 2
    assert f"another batch is writing there now (process {os.getpid()})" in second.ended.stderr
    assert [row.exit_code for row in first.rows] == [4]
    # What a killed one has left is no obstacle, and nothing is left of either.
    (out / ".batch-running").write_text("live      1\n")
    assert run_batch(list_jobs([str(capture)], BatchRequest(config)), str(out), None, QUIET).kept == 1
    assert not (out / ".batch-running").exists()


@contextmanager
def started(*command: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([sys.executable, "-m", *command], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_another_scheduler_gives_the_same_table(museum: Path, done: Done, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="a scheduler needs the extra 'batch'")
    jobs = list_jobs([str(museum / "captures")], BatchRequest(museum / "room.yaml"))
    file = tmp_path / "scheduler.json"
    scheduler = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
    with started(*scheduler, "--no-dashboard"):
        worker = ("distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-dashboard")
        with started(*worker) as first, started(*worker) as second:
            from distributed import Client

            with Client(scheduler_file=str(file), timeout=60) as known:
                known.wait_for_workers(2, timeout=120)
                address = known.scheduler.address
            with dask_workers(address) as workers:
                assert str(workers).startswith("2 workers of ")
                run_batch(jobs, str(tmp_path / "there"), lambda: workers, QUIET)
            assert first.poll() is second.poll() is None
    assert timeless(done.out) == timeless(tmp_path / "there")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--scheduler", "tcp://127.0.0.1:9"), "no Dask scheduler answers"),
        (("--scheduler", "tcp://127.0.0.1:9", "--workers", "2"), "give one of them"),
        (("--workers", "0"), "expected 1 or more"),
        (("--memory", "nan"), "--memory: expected a size of 400MB or more, as in 4GB, found 'nan'"),
        (("--memory", "1e400"), "found '1e400'"),
        (("--memory", "4"), "found '4'"),
        (("--calibration", "nothing.yaml"), "nothing.yaml: cannot be read"),
        (("--calibration", "memory://nothing.yaml"), "memory://nothing.yaml"),
        (("--calibration", __file__), "test_batch.py, line 1"),
        (("--out", "out\udcff"), "--out: expected a name"),
    ],
)
def test_mistakes_give_messages(
    museum: Path,
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("scanner.batch.workers._REACHED_WITHIN_S", 1)
    assert main(["batch", str(museum / "captures"), "--out", str(tmp_path / "out"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_process_beyond_its_memory_limit_is_ended(museum: Path, tmp_path: Path) -> None:
    jobs = list_jobs([str(museum / "captures" / "dark")], BatchRequest(museum / "room.yaml"))
    with Processes(1, memory_bytes=50e6) as processes:  # less than the libraries alone
        found = run_batch(jobs, str(tmp_path), lambda: processes, QUIET)
    assert [(row.exit_code, row.reason) for row in found.rows] == [
        (70, "the processes that worked on it were killed: out of memory, or a crash in a library")
    ]


def test_without_the_extra_only_one_machine_works(
    museum: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("distributed", "fsspec", "pyarrow"):
        monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr(running_module, "find_spec", lambda _name: None)
    out = str(tmp_path / "out")
    dark = str(museum / "captures" / "dark")
    assert main(["batch", dark, "--config", str(museum / "room.yaml"), "--out", out, "--workers", "1"]) == 0
    assert sorted(path.name for path in Path(out).iterdir()) == [CSV, PAGE, "results", "rows", "thumbnails"]
    for arguments, words in ((("--scheduler", "tcp://127.0.0.1:9"), "Dask"), (("--calibration", "s3://a/b"), "fsspec")):
        assert main(["batch", dark, "--out", out, *arguments]) == 2
        assert f"needs {words}, which is not installed; type: {BATCH.install_command()}" in capsys.readouterr().err
