"""The results that earlier scans left, and their cards: date, grade and a picture."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

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
    verdict_of,
)
from scanner.viewing import read_white_picture

SCANS = Path("scans")
NOTE_FILE = "note.txt"
_TO_SHOW = (REFUSAL_FILE, *(kind.listing for kind in KINDS))


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
