"""What the history shows of a result: when it was made, its grade, and a picture."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from scanner.capture import open_capture
from scanner.errors import InputError
from scanner.io import read_image
from scanner.patterns import White
from scanner.rendering import jpeg_uri, photograph
from scanner.results import CALIBRATION_FILE, CAPTURE_FOLDER, LOG_FILE, REFUSAL_FILE, Grade, read_verdict

_SIDE = 192


@dataclass(frozen=True)
class Card:
    """`made_s`: seconds since the epoch. `picture` is a data URI, '' for none; `grade` None where no file says."""

    name: str
    made_s: float
    grade: Grade | None
    headline: str
    picture: str


def card_of(folder: Path) -> Card:
    """Of a result folder, read anew only if it has changed."""
    return _read(folder, (folder / LOG_FILE).stat().st_mtime)


@lru_cache(maxsize=256)
def _read(folder: Path, made_s: float) -> Card:
    told = folder / (REFUSAL_FILE if (folder / REFUSAL_FILE).is_file() else CALIBRATION_FILE)
    try:
        verdict = read_verdict(told)
    except InputError:
        verdict = None
    grade, headline = (verdict.grade, verdict.headline) if verdict else (None, "")
    return Card(folder.name, made_s, grade, headline, _picture(folder))


def _picture(folder: Path) -> str:
    try:
        recording = open_capture(folder / CAPTURE_FOLDER)
        white = next(path for path, shown in zip(recording.files, recording.patterns, strict=True) if shown == White())
        return jpeg_uri(photograph(read_image(recording.folder / white), _SIDE))
    except (InputError, StopIteration):
        return ""
