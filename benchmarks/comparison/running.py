"""Cases run in a checkout, each in a folder of its own; those of a checkout without changes can be kept."""

import hashlib
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from comparison.cases import Case
from comparison.inputs import Input

COMMAND, STDOUT, STDERR, EXIT_CODE = "command.txt", "stdout.txt", "stderr.txt", "exit_code.txt"
_LONGEST_S = 600.0
_NUMERICS = ("numpy", "scipy", "numba", "opencv-python-headless", "open3d-cpu", "av")
_ENVIRONMENT = {
    "COLUMNS": "200",
    "NO_COLOR": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONDONTWRITEBYTECODE": "",
    "PYTHONHASHSEED": "0",
    "TERM": "dumb",
    "TZ": "UTC",
}


@dataclass(frozen=True)
class Checkout:
    """A folder with a version of the program."""

    folder: Path

    @property
    def commit(self) -> str | None:
        """The commit of a checkout without changes; None if there are any."""
        changes = self._git("status", "--porcelain", "--untracked-files=no")
        return None if changes else self._git("rev-parse", "HEAD")

    def _git(self, *arguments: str) -> str:
        command = ["git", "-C", str(self.folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def kept_folder(keep: Path, checkout: Checkout) -> Path | None:
    """Folder below `keep` of the results of a commit with the libraries that are installed; None if the checkout has
    changes.
    """
    if checkout.commit is None:
        return None
    versions = " ".join(f"{name} {version(name)}" for name in _NUMERICS)
    return keep / f"{checkout.commit[:12]}-{hashlib.sha256(versions.encode()).hexdigest()[:8]}"


def _needs(command: str, folder: str) -> list[str]:
    return re.findall(rf"\b{folder}/([\w-]+)", command)


class Runs:
    """Results of both checkouts, made by `workers` processes side by side.

    `old`, `new`: folders of the results, a folder for each case; `inputs`: folder of the inputs, which both share. A
    case whose folder exists in `old`, with the same command and newer than what it is made of, is not run again.
    """

    def __init__(
        self,
        checkouts: tuple[Checkout, Checkout],
        folders: tuple[Path, Path],
        cases: Mapping[str, Case],
        inputs: Mapping[str, Input],
        workers: int,
    ) -> None:
        self._checkouts, self._folders = checkouts, folders
        self._cases, self._inputs = cases, inputs
        self._pool = ThreadPoolExecutor(workers)
        self._old: dict[str, Future[Path]] = {}
        self._made: dict[str, Future[Path]] = {}

    def submit(self, name: str) -> tuple[Future[Path], Future[Path]]:
        """Start a case, and what it needs. Returns the folders of its results, before and after.

        What is needed is submitted first, so that a worker never waits for work that has not begun.
        """
        before = self._submit_old(name)
        after = self._pool.submit(self._run, name, 1, self._submit_needed(name))
        return before, after

    def close(self) -> None:
        """Begin nothing more, and wait for what runs."""
        self._pool.shutdown(cancel_futures=True)

    def _submit_old(self, name: str) -> Future[Path]:
        if name not in self._old:
            needed = self._submit_needed(name)
            self._old[name] = self._pool.submit(self._run, name, 0, needed)
        return self._old[name]

    def _submit_needed(self, name: str) -> list[Future[Path]]:
        command = self._cases[name].command
        return [
            *(self._submit_old(case) for case in _needs(command, "old")),
            *(self._submit_input(made) for made in _needs(command, "inputs")),
        ]

    def _submit_input(self, name: str) -> Future[Path]:
        if name not in self._made:
            needed = [self._submit_old(case) for case in self._inputs[name].cases]
            self._made[name] = self._pool.submit(self._make, name, needed)
        return self._made[name]

    def _make(self, name: str, needed: Iterable[Future[Path]]) -> Path:
        sources = [future.result() for future in needed]
        folder = self._folders[0] / "inputs" / name
        if not _is_newer(folder, sources):
            _make_whole(folder, lambda partial: self._inputs[name].make(partial, *sources))
        return folder

    def _run(self, name: str, side: int, needed: Iterable[Future[Path]]) -> Path:
        sources = [future.result() for future in needed]
        folder, command = self._folders[side] / "results" / name, self._cases[name].command
        is_kept = side == 0 and _is_newer(folder, sources)
        if not is_kept or (folder / COMMAND).read_text(encoding="utf-8") != command:
            links = {
                "configs": self._checkouts[side].folder / "configs",
                "old": self._folders[0] / "results",
                "inputs": self._folders[0] / "inputs",
            }
            _make_whole(folder, lambda partial: run(self._checkouts[side], command, partial, links))
        return folder


def _is_newer(folder: Path, sources: Iterable[Path]) -> bool:
    return folder.is_dir() and all(folder.stat().st_mtime >= source.stat().st_mtime for source in sources)


def _make_whole(folder: Path, make: Callable[[Path], None]) -> None:
    """Make a folder elsewhere and give it its name when it is complete, in the place of an older one.

    If another process has made it meanwhile, that one stays: somebody may be reading it.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    began_s = time.time()
    with tempfile.TemporaryDirectory(prefix=".partial-", dir=folder.parent) as scratch:
        partial = Path(scratch) / folder.name
        partial.mkdir()
        make(partial)
        if folder.is_dir() and folder.stat().st_mtime > began_s:
            return
        if folder.is_dir():
            folder.rename(Path(scratch) / "older")
        partial.rename(folder)


def run(checkout: Checkout, command: str, folder: Path, links: Mapping[str, Path]) -> None:
    """Run `scan` with the words of `command` in a folder that has `links` while it runs.

    Its output and exit code become files there.
    """
    for name, target in links.items():
        (folder / name).symlink_to(target)
    arguments = [sys.executable, "-m", "scanner", *shlex.split(command)]
    try:
        ended = subprocess.run(
            arguments,
            cwd=folder,
            env=os.environ | _ENVIRONMENT | {"PYTHONPATH": str(checkout.folder)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_LONGEST_S,
            check=False,
        )
        code, out, err = str(ended.returncode), ended.stdout, ended.stderr
    except subprocess.TimeoutExpired as error:
        code, out, err = f"none in {_LONGEST_S:.0f} s", error.stdout or b"", error.stderr or b""
    for name in links:
        (folder / name).unlink()
    for name, text in ((STDOUT, out.decode()), (STDERR, err.decode()), (EXIT_CODE, code), (COMMAND, command)):
        for place, shown in ((folder, "."), (checkout.folder, "CHECKOUT"), (Path(sys.prefix), "LIBRARIES")):
            text = text.replace(str(place), shown)
        (folder / name).write_text(text, encoding="utf-8")
