"""The result folder: it appears whole or not at all, and never over something that is not a result."""

import logging
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Self

from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import MATCHES_FILE
from scanner.ui import LogFile

CALIBRATION_FILE = "calibration.yaml"
TRUTH_FILE = "truth.yaml"
CLOUD_FILE = "cloud.ply"
REPORT_FILE = "report.html"
REFUSAL_FILE = "refused.yaml"
CAPTURE_FOLDER = "capture"
CAPTURES_FOLDER = "captures"
MERGED_FILE = "merged.ply"
POSES_FILE = "poses.yaml"
DENSE_FILE = "dense.ply"
LOG_FILE = "scan.log"

_PARTIAL = ".partial"

log = logging.getLogger(__name__)

_OURS = {
    CALIBRATION_FILE,
    TRUTH_FILE,
    CLOUD_FILE,
    MERGED_FILE,
    POSES_FILE,
    DENSE_FILE,
    REPORT_FILE,
    REFUSAL_FILE,
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    LOG_FILE,
    MATCHES_FILE,
}


def folder_of(result: Path, index: int, count: int) -> Path:
    """Where a result has its capture number `index` of `count`: the newest, which is the last, at the top."""
    return result if index == count - 1 else result / CAPTURES_FOLDER / str(index + 1)


def default_out(stem: str, *, overwrite: bool) -> Path:
    """`scans/<stem>`, with -2, -3 … added if it exists and may not be overwritten."""
    out = Path("scans") / stem
    return out if overwrite else _unused(out)


def published_name(folder: Path) -> str:
    """What a folder that `OutputFolder` made will be called; any other folder's own name."""
    hidden = folder.name.startswith(".") and folder.name.endswith(_PARTIAL)
    return folder.name[1:].rsplit(".", 2)[0] if hidden else folder.name


def beside(result: Path, ending: str) -> Path:
    """A name beside a result, made of its own: a result folder itself stays as the scan left it."""
    folder = result.resolve()
    name = f"{folder.name}{ending}"
    return folder.parent / name if result.name in ("", ".", "..") else result.parent / name


def _unused(path: Path) -> Path:
    candidate, number = path, 1
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


@contextmanager
def new_result(out: Path, config: Config, *, overwrite: bool, keep_capture: bool = False) -> Iterator[Path]:
    """The folder to write a result into, with a log in it; it becomes `out` as described at `OutputFolder`."""
    with OutputFolder(out, overwrite=overwrite, keep_capture=keep_capture) as output, LogFile(output.folder / LOG_FILE):
        log.info("scan %s with the configuration %s", version("roomscan"), config.model_dump_json(exclude_unset=True))
        yield output.folder


class OutputFolder:
    """A hidden folder beside `out` that takes its place when the `with` block ends well.

    It ends well without an error, or with RefusalError: that a capture cannot be calibrated is a result too. Any other
    error discards the folder, except that a live capture (`keep_capture`) is moved to `<out>-incomplete`: it may not
    be possible to repeat. What became of it is added to the error as a note.

    Raises InputError if `out` exists, unless it is an empty folder, or a result of ours and `overwrite` is set.
    """

    def __init__(self, out: Path, *, overwrite: bool = False, keep_capture: bool = False) -> None:
        self.out = out.absolute()
        self._shown = out
        self._overwrite = overwrite
        self._keep_capture = keep_capture
        if _is_occupied(self.out):
            _refuse_to_lose(out, overwrite=overwrite)
        self.folder = self.out.with_name(f".{self.out.name}.{os.getpid()}{_PARTIAL}")

    def __enter__(self) -> Self:
        self._new_parents = [parent for parent in self.out.parents if not parent.exists()]
        try:
            self.folder.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"{self._shown}: cannot be made: {error.strerror}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self._publish()
        elif isinstance(error, RefusalError):
            self._publish()
            kept = "matches and a report are" if (self.out / MATCHES_FILE).exists() else "recording is"
            error.add_note(f"The {kept} in {self._shown}.")
        elif self._keep_capture and _frames_in(self.folder):
            error.add_note(self._keep())
        else:
            self._discard()

    def _publish(self) -> None:
        replaced = self.folder.with_suffix(".replaced")
        try:
            if _is_occupied(self.out):
                _refuse_to_lose(self.out, overwrite=self._overwrite)
                self.out.rename(replaced)
            self.folder.rename(self.out)
        except (OSError, InputError) as error:
            if replaced.exists():
                replaced.rename(self.out)
            raise InputError(f"{error}; the result is in {self.folder}") from error
        shutil.rmtree(replaced, ignore_errors=True)

    def _keep(self) -> str:
        kept = _unused(self.out.with_name(f"{self.out.name}-incomplete"))
        self.folder.rename(kept)
        shown = self._shown.with_name(kept.name)
        if (kept / CAPTURES_FOLDER).exists():
            finished = len(list((kept / CAPTURES_FOLDER).iterdir()))
            return (
                f"What was captured so far is kept: {finished} whole capture{'s' if finished > 1 else ''} in "
                f"{shown / CAPTURES_FOLDER}, which scan calibrate takes, and {_frames_in(kept / CAPTURE_FOLDER)} "
                f"frames in {shown / CAPTURE_FOLDER}."
            )
        return f"The {_frames_in(kept)} frames captured so far are in {shown / CAPTURE_FOLDER}."

    def _discard(self) -> None:
        shutil.rmtree(self.folder)
        for parent in self._new_parents:
            with suppress(OSError):  # someone else has put something there since
                parent.rmdir()


def refuse_occupied(out: Path) -> None:
    """Raise InputError if there is something at `out` already, other than an empty folder."""
    if _is_occupied(out):
        _refuse_to_lose(out, overwrite=False)


def _is_occupied(path: Path) -> bool:
    """An empty folder is as good as none: nothing can be lost, and a rename replaces it."""
    if path.is_dir() and not path.is_symlink():
        return any(path.iterdir())
    return path.exists() or path.is_symlink()


def _refuse_to_lose(out: Path, *, overwrite: bool) -> None:
    if not overwrite:
        raise InputError(f"{out}: already exists; choose another --out, or replace an earlier result with --overwrite")
    if out.is_symlink() or not out.is_dir() or not (out / LOG_FILE).is_file():
        raise InputError(f"{out}: exists and is no result of an earlier scan, so it is not overwritten")
    foreign = sorted(path.name for path in out.iterdir() if path.name not in _OURS)
    if foreign:
        raise InputError(f"{out}: is not overwritten, because it holds what no scan has written: {', '.join(foreign)}")


def _frames_in(folder: Path) -> int:
    """How many frames were recorded anywhere in a folder."""
    return len(list(folder.glob("**/frames/*.png")))
