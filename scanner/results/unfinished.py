"""A folder in the making: who makes it, its progress, and what happens to it after an interruption.

`.NAME.partial` beside NAME holds what is written for NAME. The file `STATE` in it holds the progress, and is locked by
the writing process; an unlocked state was left behind by a killed one. It is removed last, so that every moment can be
identified:

    .NAME.partial, state 'live' or 'made'        incomplete; the frames of a live capture are worth keeping
    .NAME.partial, state 'whole' or 'replacing'  complete, and not yet in its place
    NAME with a state                            in its place; an older result may be left, in .NAME.partial, where the
                                                 exchange puts it, or in .NAME.replaced, before its removal
"""

import fcntl
import os
import shutil
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from scanner.errors import InputError
from scanner.io import exchange, sync

STATE = ".scan-unfinished"
_PARTIAL, _REPLACED = ".partial", ".replaced"


class FolderState(StrEnum):
    """The progress of the folder; `REPLACING`: it is complete and takes the place of an older result."""

    LIVE = "live"
    MADE = "made"
    WHOLE = "whole"
    REPLACING = "replacing"


class LockedError(InputError):
    """Another process is making the same."""


def partial_of(out: Path) -> Path:
    """Return the folder in which `out` is written until it is complete."""
    return out.with_name(f".{out.name}{_PARTIAL}")


def target_of(partial: Path) -> Path:
    """Return the final path of a partial folder."""
    return partial.with_name(partial.name[1 : -len(_PARTIAL)])


def published_name(folder: Path) -> str:
    """Return the final name of a folder that is being made; any other folder's own name."""
    hidden = folder.name.startswith(".") and folder.name.endswith(_PARTIAL)
    return target_of(folder).name if hidden else folder.name


def is_held(out: Path) -> bool:
    """Whether a process that is alive is making `out`."""
    state = partial_of(out) / STATE
    if not state.is_file():
        return False
    try:
        Claim(state).release()
    except (LockedError, OSError):
        return True
    return False


class Claim:
    """The lock on a state file of what a `scan` or something else makes, held until `release`.

    `remove`: what stands in the way if no process is at work; None for the file's folder. Raises LockedError if another
    process has it, OSError.
    """

    def __init__(self, path: Path, *, make: bool = False, maker: str = "scan", remove: Path | None = None) -> None:
        self.path = path
        self._file = os.open(path, os.O_RDWR | (os.O_CREAT if make else 0), 0o644)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = self._words()[1:]
            if make and not holder and not isinstance(error, BlockingIOError):
                return  # a file system without locks: assume that nobody is at work
            os.close(self._file)
            by = f" (process {holder[0]})" if holder else ""
            raise LockedError(
                f"another {maker} is writing there now{by}: wait for it, or choose another --out; if there is none, "
                f"remove {remove or path.parent}"
            ) from error

    @property
    def state(self) -> FolderState | None:
        """What it says; None where that was not written any more."""
        words = self._words()
        return FolderState(words[0]) if words and words[0] in list(FolderState) else None

    def say(self, state: FolderState) -> None:
        """Write the state, all of it or nothing. Raises OSError."""
        os.pwrite(self._file, f"{state:<9} {os.getpid():<10}\n".encode(), 0)
        os.fsync(self._file)

    @property
    def is_current(self) -> bool:
        """Whether the file that is locked is still the one of that name."""
        with suppress(OSError):
            return self.path.stat().st_ino == os.fstat(self._file).st_ino
        return False

    def release(self) -> None:
        """Let others have it."""
        with suppress(OSError):
            os.close(self._file)

    def _words(self) -> list[str]:
        return os.pread(self._file, 64, 0).decode("ascii", "replace").split()


def publish(partial: Path, out: Path) -> None:
    """Move a complete folder into its place, and remove an earlier one. Raises OSError."""
    if not out.exists() or not exchange(partial, out):
        if out.exists():
            out.rename(_older(out))
        partial.rename(out)
    _tidy(out)


def finish_publishing(out: Path) -> None:
    """Finish the publication of a killed process whose result was in its place. Raises LockedError, OSError."""
    if (out / STATE).is_file() and not out.is_symlink():
        claim = Claim(out / STATE)
        try:
            _tidy(out)
        finally:
            claim.release()


def _tidy(out: Path) -> None:
    sync(out.parent)
    partial = partial_of(out)
    if partial.exists() and not (partial / STATE).exists():
        partial.rename(_older(out))
    shutil.rmtree(_older(out), ignore_errors=True)
    (out / STATE).unlink()


def _older(out: Path) -> Path:
    return out.with_name(f".{out.name}{_REPLACED}")
