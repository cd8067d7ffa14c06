"""Text made fit to be shown: a terminal obeys some characters of files, and lines must not break within numbers."""

import re
import reprlib
from collections.abc import Iterable

_MARK = "\N{REPLACEMENT CHARACTER}"
# Control characters except line breaks and tabs; bidirectional controls; lone surrogates.
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
_MOST_CHARACTERS = 60
NO_BREAK = "\N{NO-BREAK SPACE}"
# Parts of a quantity: a sign before a number; a unit or the end of a range after it.
_WITHIN_NUMBERS = re.compile(
    r"(?<=[±<>=×−+]) (?=[\d−])|(?<=\d) (?=(?:[±×%°‰]|[mµk]?m\b|px\b|sigma|to \d))|(?<=\d to) (?=\d)"
)

_NAMES = re.compile("[^/=]+")  # of files and folders, in an argument
_BREAK = re.compile("[\t\n]")

_broken_names: list[str] = []

_REPR = reprlib.Repr()
_REPR.maxlevel = 3
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = _MOST_CHARACTERS


def harmless(text: str) -> str:
    """The text with a mark in place of every character that a terminal would obey."""
    return _OBEYED.sub(_MARK, text)


def expect_names_of(arguments: Iterable[str]) -> None:
    """Take note of the names of files on a command line that have line breaks in them, for `on_screen`."""
    names = {harmless(name) for argument in arguments for name in _NAMES.findall(argument) if _BREAK.search(name)}
    _broken_names[:] = sorted(names, key=len, reverse=True)


def on_screen(text: str) -> str:
    """The text with a mark in place of all that a terminal would obey: line breaks, too, that are part of a name, so
    that only those of a message begin a line.
    """
    text = harmless(text)
    for name in _broken_names:
        text = text.replace(name, _BREAK.sub(_MARK, name))
    return text


def shortened(text: str, most: int = _MOST_CHARACTERS) -> str:
    """The text, or its beginning and an ellipsis."""
    return text if len(text) <= most else text[: most - 1] + "…"


def shown(value: object) -> str:
    """A value for a message: on one line, and shortened."""
    return shortened(harmless(_REPR.repr(value)))


def capitalised(text: str) -> str:
    """The text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def unbroken(text: str) -> str:
    """The text with no-break spaces within numbers and between them and their units."""
    return _WITHIN_NUMBERS.sub(NO_BREAK, text)
