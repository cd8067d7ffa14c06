"""The result folder: it appears whole or not at all, and never over something that is not a result.

The steps that are done to a result's cloud, as a file in it; the cloud itself stays as it was measured.
"""

import logging
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import Field

from calib.refusal import RefusalError
from scanner.configuration import MOST_STEPS, CloudStep, Config
from scanner.errors import InputError, StorageError, cannot_write, is_of_the_disk
from scanner.interruption import finishing
from scanner.io import (
    MATCHES_FILE,
    Entry,
    flow_yaml,
    missing_folders,
    new_file,
    read_yaml,
    remove_empty,
    sync_tree,
    validate,
)
from scanner.results.leftovers import frames_in, keep_recording, kept_text, settle
from scanner.results.names import (
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    LOG_FILE,
    STEPS_FILE,
    is_occupied,
    kind_of,
    refuse_to_lose,
    unused,
)
from scanner.results.unfinished import STATE, Claim, FolderState, LockedError, partial_of, publish
from scanner.ui import LogFile

log = logging.getLogger(__name__)

# Two scans that begin at the same moment may block each other for this long.
_ATTEMPTS, _PAUSE_S = 20, 0.005


class _StepsEntry(Entry):
    steps: tuple[CloudStep, ...] = Field(max_length=MOST_STEPS)


def read_steps(folder: Path) -> tuple[CloudStep, ...]:
    """Of a result, in their order; none without such a file. Raises InputError if it is malformed."""
    path = folder / STEPS_FILE
    return validate(_StepsEntry, read_yaml(path), str(path)).steps if path.is_file() else ()


def write_steps(folder: Path, steps: Sequence[CloudStep]) -> None:
    """Write them, in place of those that are there; without any, there is no file. Raises InputError, StorageError."""
    path = folder / STEPS_FILE
    if not steps:
        path.unlink(missing_ok=True)
        return
    lines = [f"  - {flow_yaml({step.name: step.parameter})}" for step in steps]
    with new_file(path, overwrite=True) as partial:
        partial.write_text("\n".join(["steps:", *lines]) + "\n", encoding="utf-8")


@contextmanager
def new_result(
    out: Path,
    config: Config,
    *,
    overwrite: bool,
    keep_capture: bool = False,
    tell: Callable[[str], None] = log.warning,
) -> Iterator[Path]:
    """The folder of a new result, with a log in it; it becomes `out` as described at `OutputFolder`."""
    output = OutputFolder(out, overwrite=overwrite, keep_capture=keep_capture, tell=tell)
    with output, LogFile(output.folder / LOG_FILE):
        for sentence in output.settled:
            log.info(sentence)
        log.info("scan %s with the configuration %s", version("roomscan"), config.as_json())
        yield output.folder
        if (output.folder / kind_of(output.folder).cloud).is_file():
            write_steps(output.folder, config.cloud.all_steps)


class OutputFolder:
    """A hidden folder beside `out` that replaces it in one step when the `with` block succeeds.

    It succeeds without an error, or with RefusalError, because a refused capture has a result, too. Any other error
    discards the folder, but the frames of a live capture (`keep_capture`) are moved to `<out>-incomplete`, as they may
    not be repeatable. The outcome is added to the error as a note. An OSError of the disk becomes a StorageError.

    Meanwhile no other process can make `out`. Leftovers of killed programs are settled first; `tell` receives a
    sentence on each.

    Raises InputError if `out` exists, unless it is an empty folder, or a result of ours and `overwrite` is set (None:
    there is no such option), or if another process is making it.
    """

    def __init__(
        self,
        out: Path,
        *,
        overwrite: bool | None = None,
        keep_capture: bool = False,
        tell: Callable[[str], None] = log.warning,
    ) -> None:
        self.out = out.absolute()
        self._shown = out
        self._overwrite = overwrite
        self._keep_capture = keep_capture
        self.settled = settle(out)
        for sentence in self.settled:
            tell(sentence)
        if is_occupied(self.out):
            refuse_to_lose(out, overwrite=overwrite)
        self.folder = partial_of(self.out)

    def __enter__(self) -> Self:
        self._new_parents = missing_folders(self.out.parent)
        try:
            self._claim = self._claimed()
            self._claim.say(FolderState.LIVE if self._keep_capture else FolderState.MADE)
        except LockedError as error:
            raise InputError(f"{self._shown}: {error}") from error
        except OSError as error:
            raise cannot_write(self._shown, error, "made") from error
        return self

    def _claimed(self) -> Claim:
        """The folder, made and locked. Raises LockedError, OSError."""
        held = LockedError("another scan is beginning there now; choose another --out")
        for _ in range(_ATTEMPTS):
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                claim = Claim(self.folder / STATE, make=True)
            except FileNotFoundError:
                continue  # another scan took it for an empty folder left by a killed program
            except LockedError as error:
                held = error  # held only for a moment, if another scan is checking for leftovers
                time.sleep(_PAUSE_S)
                continue
            if claim.is_current and claim.state is None:
                return claim
            claim.release()
            settle(self.out)
        raise held

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            with finishing(ending=error is not None):
                try:
                    self._end(error)
                finally:
                    self._claim.release()
        except KeyboardInterrupt as late:
            late.add_note(f"The result is in {self._shown}.")
            raise
        if error is not None and is_of_the_disk(error):
            named = self._by_its_name(error)
            for note in getattr(error, "__notes__", []):
                named.add_note(note)
            raise named from error

    def _by_its_name(self, error: BaseException) -> Exception:
        """The same disk error with the public name, because nobody knows the hidden folder."""
        if isinstance(error, OSError):
            return cannot_write(self._shown, error)
        return StorageError(str(error).replace(str(self.folder), str(self._shown)))

    def _end(self, error: BaseException | None) -> None:
        if error is None:
            self._publish()
        elif isinstance(error, RefusalError):
            self._publish()
            kept = "recording is" if (self.out / CAPTURE_FOLDER).exists() else "reason is"
            if (self.out / MATCHES_FILE).exists():
                kept = "matches and a report are"
            if kind_of(self.out).is_joined:
                kept = "report and everything else are"
            elif (self.out / CAPTURES_FOLDER).exists():
                kept = "captures are"
            error.add_note(f"The {kept} in {self._shown}.")
        elif self._keep_capture and frames_in(self.folder):
            error.add_note(self._keep(refuted=isinstance(error, InputError)))
        else:
            self._discard()

    def _publish(self) -> None:
        try:
            sync_tree(self.folder)
            place, trouble = self.out, None
            replacing = is_occupied(place)
            if replacing:
                try:
                    refuse_to_lose(place, overwrite=self._overwrite)
                except InputError as error:  # another scan was faster
                    place, trouble, replacing = unused(place), error, False
            self._claim.say(FolderState.REPLACING if replacing else FolderState.WHOLE)
            publish(self.folder, place)
        except OSError as error:
            raise StorageError(f"{cannot_write(self._shown, error)}; the result is in {self.folder}") from error
        if trouble is not None:
            raise InputError(f"{trouble}; the result is in {self._shown.with_name(place.name)}") from trouble

    def _keep(self, *, refuted: bool) -> str:
        try:
            kept = keep_recording(self.folder, self.out)
        except OSError as error:
            return f"The frames captured so far are in {self.folder} ({cannot_write(self.folder, error)})."
        return kept_text(self._shown.with_name(kept.name), refuted=refuted)

    def _discard(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)  # the next scan settles what remains
        remove_empty(self._new_parents)
