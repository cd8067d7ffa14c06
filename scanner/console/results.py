"""The results that earlier scans left, and their cards: date, grade and a picture.

The folder of results as a shelf: a result gets another name, a note, or goes into a bin that gives it back.

Nothing is destroyed: the bin is a folder, and what is in it stays until somebody empties it outside of this program.
"""

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from scanner.console.settings import plain_name
from scanner.errors import InputError
from scanner.io import read_text
from scanner.rendering import jpeg_uri
from scanner.results import (
    CALIBRATION_FILE,
    CAPTURES_FOLDER,
    KINDS,
    LOG_FILE,
    REFUSAL_FILE,
    Grade,
    unused,
    verdict_of,
)
from scanner.viewing import read_white_picture

SCANS = Path("scans")
NOTE_FILE = "note.txt"
_TO_SHOW = (REFUSAL_FILE, *(kind.listing for kind in KINDS))
BIN = ".bin"
_LONGEST_NOTE = 4000


def earlier_results(folder: Path = SCANS) -> tuple[Path, ...]:
    """Result folders in `folder`, the newest first; refused captures too, for they say why."""
    try:
        logged = (path for path in folder.iterdir() if (path / LOG_FILE).is_file())
        results = [path for path in logged if any((path / name).is_file() for name in _TO_SHOW)]
    except OSError:
        return ()  # nothing was scanned yet
    return tuple(sorted(results, key=lambda path: ((path / LOG_FILE).stat().st_mtime, path.name), reverse=True))


def newest_result() -> Path | None:
    """The newest of them; None where there is none."""
    return next(iter(earlier_results()), None)


def newest_calibration() -> Path | None:
    """That of the newest result that has one; None where none has."""
    calibrations = (result / CALIBRATION_FILE for result in earlier_results())
    return next((path for path in calibrations if path.is_file()), None)


_SIDE = 192


@dataclass(frozen=True)
class Card:
    """`made_s`: seconds since the epoch. `picture` is a data URI, '' for none; `grade` None where no file says; `note`
    is the operator's.
    """

    name: str
    made_s: float
    grade: Grade | None
    headline: str
    picture: str
    note: str


def changes_s(result: Path) -> tuple[float, float]:
    """When a result was made and its note written, in seconds since the epoch; 0 for no note. Raises OSError."""
    note = result / NOTE_FILE
    return (result / LOG_FILE).stat().st_mtime, note.stat().st_mtime if note.is_file() else 0.0


def note_of(result: Path) -> str:
    """The operator's note on a result; '' for none, or one that cannot be read."""
    try:
        return read_text(result / NOTE_FILE)
    except InputError:
        return ""


@lru_cache(maxsize=256)
def card_of(folder: Path, made_s: float, noted_s: float = 0.0) -> Card:  # noqa: ARG001  # part of the cache's key
    """Return the card of a result folder with those time stamps, cached until the result or its note changes."""
    try:
        verdict = verdict_of(folder)
    except InputError:
        verdict = None
    grade, headline = (verdict.grade, verdict.headline) if verdict else (None, "")
    places = (folder, *sorted((folder / CAPTURES_FOLDER).glob("*/")))
    picture = next((white for place in places if (white := read_white_picture(place, _SIDE)) is not None), None)
    return Card(folder.name, made_s, grade, headline, "" if picture is None else jpeg_uri(picture), note_of(folder))


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
