"""Text that came from files, made fit to be shown: a terminal obeys some characters instead of showing them."""

import re
import reprlib

_MARK = "\N{REPLACEMENT CHARACTER}"
# Control characters but for line breaks and tabs; those that turn the direction of what follows; lone surrogates.
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
_MOST_CHARACTERS = 60

_REPR = reprlib.Repr()
_REPR.maxlevel = 3
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = _MOST_CHARACTERS


def harmless(text: str) -> str:
    """The text with a mark in place of every character that a terminal would obey."""
    return _OBEYED.sub(_MARK, text)


def shortened(text: str, most: int = _MOST_CHARACTERS) -> str:
    """The text, or its beginning and an ellipsis."""
    return text if len(text) <= most else text[: most - 1] + "…"


def shown(value: object) -> str:
    """A value as it stands in a message: on one line, and never all of a long one."""
    return shortened(harmless(_REPR.repr(value)))
