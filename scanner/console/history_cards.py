"""Cards of the history: date of each result, its grade, and a picture."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from scanner.errors import InputError
from scanner.rendering import jpeg_uri
from scanner.results import CAPTURES_FOLDER, Grade, verdict_of
from scanner.viewing.white_picture import white_picture

_SIDE = 192


@dataclass(frozen=True)
class Card:
    """`made_s`: seconds since the epoch. `picture` is a data URI, '' for none; `grade` None where no file says."""

    name: str
    made_s: float
    grade: Grade | None
    headline: str
    picture: str


@lru_cache(maxsize=256)
def card_of(folder: Path, made_s: float) -> Card:
    """Return the card of a result folder with that time stamp, cached until the result changes."""
    try:
        verdict = verdict_of(folder)
    except InputError:
        verdict = None
    grade, headline = (verdict.grade, verdict.headline) if verdict else (None, "")
    places = (folder, *sorted((folder / CAPTURES_FOLDER).glob("*/")))
    picture = next((white for place in places if (white := white_picture(place, _SIDE)) is not None), None)
    return Card(folder.name, made_s, grade, headline, "" if picture is None else jpeg_uri(picture))
