"""The captures of a batch, and the options of each."""

import csv
import hashlib
import io
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path, PurePosixPath

from scanner.batch.location import Location
from scanner.capture import CAPTURE_FILE
from scanner.configuration import Config, load_config
from scanner.errors import InputError
from scanner.io import parse_calibration
from scanner.results import CAPTURE_FOLDER
from scanner.shown_text import harmless, shown

_COLUMNS = {"capture", "name", "config", "calibration", "set"}
_LINE_BREAKS = frozenset("\n\r\t")
_LONGEST_NAME_BYTES = 240  # common file systems have 255


@dataclass(frozen=True)
class BatchJob:
    """A capture to reconstruct with a configuration, and with a calibration (the file's text) if that is known."""

    name: str
    capture: str
    config: Config
    calibration: str | None = None

    @property
    def asked(self) -> str:
        """Digest of the request: if it changes, an earlier result is invalid."""
        text = f"{self.capture}\n{self.config.model_dump_json(exclude_unset=True)}\n{self.calibration}"
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class BatchRequest:
    """What the command line asks of every capture; an entry of the list may override it."""

    config: Path | None = None
    overrides: tuple[str, ...] = ()
    calibration: str | None = None  # may be remote, as the captures

    def of_any(self) -> BatchJob:
        """A job without a name and a capture. Raises InputError."""
        return BatchJob("", "", load_config(self.config, self.overrides), self._known)

    def refuse_no_calibration(self) -> None:
        """Raise InputError if the common calibration is invalid, instead of in every row."""
        if self._known is not None:
            parse_calibration(self._known, str(self.calibration))

    @cached_property
    def _known(self) -> str | None:
        return None if self.calibration is None else Location(self.calibration).read().decode("utf-8", "replace")


def list_jobs(sources: Sequence[str], asked: BatchRequest) -> tuple[BatchJob, ...]:
    """A job for each capture below folders, in names with * in them, or in lists (.csv), sorted by name.

    A list has a column `capture` and may have `name`, `config`, `calibration` and `set` (overrides, with ; between
    them); its paths are relative to it. Raises InputError if nothing is found, or a list is malformed.
    """
    jobs: dict[str, BatchJob] = {}
    for source in sources:
        requests = list(
            _from_list(Location(source), asked) if source.endswith(".csv") else _from_folders(source, asked)
        )
        if not requests:
            raise InputError(f"{source}: expected captures, folders with a {CAPTURE_FILE}; found none")
        for job in requests:
            name, number = job.name, 1
            while name in jobs and jobs[name].capture != job.capture:
                number += 1
                name = f"{job.name}-{number}"
            jobs[name] = replace(job, name=name)
    _refuse_nested(jobs)
    return tuple(jobs[name] for name in sorted(jobs))


def _refuse_nested(names: Collection[str]) -> None:
    for name in names:
        for outer in map(str, PurePosixPath(name).parents):
            if outer in names:
                raise InputError(
                    f"two captures would be called {shown(outer)} and {shown(name)}, one result inside of the other: "
                    "give one of them another name, in a list's column 'name'"
                )


def _from_folders(source: str, asked: BatchRequest) -> Iterator[BatchJob]:
    template = asked.of_any()
    for root in Location(source).glob() if "*" in source else [Location(source)]:
        if not root.exists:
            raise InputError(f"{root.url}: there is no such folder")
        for folder in _captures_below(root):
            yield replace(template, name=_name(folder.url, root.url), capture=folder.url)


def _captures_below(root: Location) -> Iterator[Location]:
    for folder, folders, files in root.walk():
        folders.sort() if isinstance(folders, list) else None
        if CAPTURE_FILE in files:
            folders.clear()  # a capture folder contains only frames
            yield folder


def _name(capture: str, root: str) -> str:
    """A capture's path below the root; the recording of a result is called `capture`: the result's name says more."""
    whole, start = Location(capture).parts, len(Location(root).parts)
    if whole[-1] == CAPTURE_FOLDER and len(whole) > 1:
        whole = whole[:-1]
    return "/".join(whole[start:] or whole[-1:])


def _from_list(file: Location, asked: BatchRequest) -> Iterator[BatchJob]:
    rows = csv.DictReader(io.StringIO(file.read().decode("utf-8-sig", "replace"), newline=None))
    try:
        yield from _from_rows(rows, file, asked)
    except csv.Error as error:
        raise InputError(f"{file.url}, line {rows.line_num + 1}: not a table of values: {error}") from error


def _from_rows(rows: "csv.DictReader[str]", file: Location, asked: BatchRequest) -> Iterator[BatchJob]:
    columns = set(rows.fieldnames or ())
    if "capture" not in columns or columns - _COLUMNS:
        raise InputError(
            f"{file.url}: expected the columns {', '.join(sorted(_COLUMNS))} ('capture' at least), found "
            f"{', '.join(sorted(columns)) or 'none'}"
        )
    folder = file.url.rpartition("/")[0]
    template_of = cache(BatchRequest.of_any)  # a list may have thousands of lines with the same options
    for number, row in enumerate(rows, start=2):
        if not row["capture"]:
            raise InputError(f"{file.url}, line {number}: no capture is named")
        capture = _beside(folder, row["capture"])
        own = BatchRequest(
            Path(_beside(folder, row["config"])) if row.get("config") else asked.config,
            (*asked.overrides, *(part.strip() for part in (row.get("set") or "").split(";") if part.strip())),
            _beside(folder, row["calibration"]) if row.get("calibration") else asked.calibration,
        )
        name = row.get("name") or _name(capture, capture)
        if not all(map(_may_be_a_name, name.split("/"))):
            raise InputError(f"{file.url}, line {number}: expected a name below the results, found {shown(name)}")
        for text in (row["capture"], name):  # they become names of files, and cells of tables
            if harmless(text) != text or not _LINE_BREAKS.isdisjoint(text):
                raise InputError(f"{file.url}, line {number}: a name has a control character, found {shown(text)}")
        yield replace(template_of(own), name=name, capture=capture)


def _may_be_a_name(part: str) -> bool:
    """Whether a folder, or a file with an ending, can be called so, and is then where its path says."""
    return part not in ("", ".", "..") and "\0" not in part and len(part.encode()) <= _LONGEST_NAME_BYTES


def _beside(folder: str, path: str) -> str:
    absolute = "://" in path or Path(path).is_absolute() or not folder
    return path if absolute else f"{folder}/{path}"
