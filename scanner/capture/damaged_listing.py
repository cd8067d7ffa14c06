"""Read the listing of a recording that was broken off while its last line was being written, or that lacks files."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calib.finding import Finding, FindingKind, Severity
from scanner.capture.recorder import frame_file
from scanner.errors import InputError
from scanner.io import Entry, parse_mapping, read_image, read_text, validate
from scanner.patterns import Pattern, PatternEntry
from scanner.shown_text import shown

# Of our own listings: beginnings of a line without a bracket yet, and lines that are whole when the last one is closed.
_BEGUN = re.compile(r" *-? ?|\w[\w ]*")
_BRACKETED = re.compile(r"( *- |\w[\w ]*: )\{.*")

BROKEN_OFF = FindingKind(
    "broken-off",
    "The recording was broken off while it was being written; what was incomplete is left out.",
    "Complete the capture with scan --resume, or capture again.",
)
MISSING_FILES = FindingKind(
    "missing-files",
    "Files of listed frames are missing; the capture was decoded without them.",
    "Copy the whole capture once more, or capture again.",
    ("missing_frames",),
)
_MOST_NAMED = 3


class _PlanEntry(Entry):
    sequence: list[PatternEntry]


def read_listing(path: Path) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """The mapping in a `capture.yaml`, without a last line that is torn, and a warning if it was. Raises InputError."""
    text = read_text(path)
    whole, newline, last = text.rpartition("\n")
    torn = _is_damaged(last)
    if torn:
        text = whole + newline
    value = parse_mapping(text, str(path))
    if "sequence" in value and not value.get("frames"):
        raise InputError(f"{path}: no frame was recorded before the interruption: capture again")
    return value, ((left_out(f"The last line of {path.name} is incomplete, and left out."),) if torn else ())


def left_out(message: str) -> Finding:
    """A warning about what is incomplete in a recording."""
    return Finding(BROKEN_OFF, Severity.WARNING, message)


def missing_files(files: Sequence[str]) -> Finding:
    """A warning about files that are listed and not there."""
    named = ", ".join(map(shown, files[:_MOST_NAMED])) + (" and others" if len(files) > _MOST_NAMED else "")
    message = f"Of the listed frames {len(files)} {'is' if len(files) == 1 else 'are'} missing, and left out: {named}."
    return Finding(
        MISSING_FILES, Severity.WARNING, message, MISSING_FILES.remedy, {"missing_frames": float(len(files))}
    )


def _is_damaged(last: str) -> bool:
    """Whether a last line without an end is the beginning of one that we write."""
    if _BRACKETED.fullmatch(last):
        return last.count("{") != last.count("}")
    return bool(last) and _BEGUN.fullmatch(last) is not None


def damaged_image(folder: Path, file: str) -> Finding | None:
    """A warning about the last frame's image if it is missing or damaged; None if it is whole, or no file in there."""
    path = folder / file
    if Path(file).is_absolute() or ".." in Path(file).parts or "\0" in file:
        return None
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            return None
        read_image(path)
    except OSError:
        return None
    except InputError as error:
        return left_out(f"The last frame, {file}, is left out ({str(error).removeprefix(f'{path}: ')}).")
    return None


def unlisted(folder: Path, count: int) -> Path | None:
    """The image that would have been listed next, after `count` frames, if it is there."""
    path = folder / frame_file(count)
    return path if path.exists() else None


def planned_patterns(metadata: Mapping[str, Any], patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
    """The patterns that were to be shown, if a recording says so: those `shown` are the first of them."""
    try:
        entry = validate(_PlanEntry, {"sequence": metadata.get("sequence")}, "")
    except InputError:
        return ()  # another program's key of that name
    planned = tuple(entry_pattern.pattern() for entry_pattern in entry.sequence)
    return planned if planned[: len(patterns)] == tuple(patterns) else ()
