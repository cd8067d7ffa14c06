"""The folder of results as a shelf: a result gets another name, a note, or goes into a bin that gives it back.

Nothing is destroyed: the bin is a folder, and what is in it stays until somebody empties it outside of this program.
"""

import contextlib
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from scanner.console.results import NOTE_FILE, SCANS
from scanner.console.settings import plain_name
from scanner.errors import InputError
from scanner.results import unused

BIN = ".bin"
_LONGEST_NOTE = 4000


def rename_result(result: Path, typed: str) -> Path:
    """Give a result another name in the same folder, of letters, digits, dots and dashes; returns where it is.

    Raises InputError, with nothing changed, if nothing of the name remains, or it is taken.
    """
    name = plain_name(typed)
    if not name:
        raise InputError("a name needs a letter or a digit: type another one")
    place = result.with_name(name)
    if place == result:
        return result
    with _explained(result, f"renamed to {name}"):
        if os.path.lexists(place) or unused(place) != place:
            raise InputError(f"there is a result called {name} already: choose another name")
        return result.rename(place)


def write_note(result: Path, text: str) -> None:
    """Keep a note with a result, in place of the last one; an empty one removes it. Raises InputError."""
    if len(text) > _LONGEST_NOTE:
        raise InputError(f"a note has up to {_LONGEST_NOTE} characters, this one {len(text)}: shorten it")
    note, fresh = result / NOTE_FILE, result / f".{NOTE_FILE}.{os.getpid()}.partial"
    with _explained(note, "written"):
        if not text.strip():
            note.unlink(missing_ok=True)
            return
        try:
            # A half of a pair of UTF-16, which a browser may send, cannot be written.
            fresh.write_text(text, encoding="utf-8", errors="replace", newline="\n")
            fresh.replace(note)
        finally:
            fresh.unlink(missing_ok=True)


def bin_result(result: Path) -> Path:
    """Move a result into the bin beside it; returns where it is. Raises InputError, with nothing changed."""
    # By time, so that the last one is known, and names can be there twice.
    place = result.parent / BIN / f"{datetime.now(UTC):%Y%m%d-%H%M%S-%f}" / result.name
    with _explained(result, "moved into the bin"):
        place.parent.mkdir(parents=True)
        try:
            return result.rename(place)
        except OSError:
            place.parent.rmdir()
            raise


def last_binned(folder: Path = SCANS) -> Path | None:
    """What was moved into the bin last; None if it is empty."""
    try:
        return max((path for path in (folder / BIN).glob("*/*")), key=lambda path: path.parent.name, default=None)
    except OSError:
        return None


def restore_result(binned: Path) -> Path:
    """Take a result out of the bin, with -2 after its name if that is taken; returns where it is. Raises InputError."""
    place = unused(binned.parents[2] / binned.name)
    with _explained(binned, "taken out of the bin"):
        restored = binned.rename(place)
    with contextlib.suppress(OSError):  # there is something else
        binned.parent.rmdir()
        binned.parents[1].rmdir()
    return restored


@contextlib.contextmanager
def _explained(path: Path, done: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be {done}: {error.strerror}; nothing was changed") from error
