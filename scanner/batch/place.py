"""A folder that may be far away: whatever fsspec reads and writes, such as s3://bucket/folder."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import fsspec
from fsspec.implementations.local import LocalFileSystem

from scanner.errors import InputError
from scanner.io import new_file, read_bytes

_MOST_BYTES = 200_000_000  # a list of a million captures


@dataclass(frozen=True)
class Place:
    """A folder or a file, by its URL or its path."""

    url: str

    def __truediv__(self, name: str) -> "Place":
        return Place(f"{self.url.rstrip('/')}/{name}")

    @property
    def local(self) -> Path | None:
        """Its path on this machine; None if it is not on it."""
        system, path = self._resolved()
        return Path(path) if isinstance(system, LocalFileSystem) else None

    @property
    def parts(self) -> tuple[str, ...]:
        """The folders on the way, however the URL writes them, and its own name."""
        return tuple(self._resolved()[1].strip("/").split("/"))

    def walk(self) -> Iterator[tuple["Place", list[str], list[str]]]:
        """As `os.walk`, from the top: folders that are taken out of the list are not gone into."""
        system, path = self._resolved()
        for folder, folders, files in cast(Any, system).walk(path, topdown=True):
            yield Place(_shown(system, folder)), folders, files

    def glob(self) -> list["Place"]:
        """What a URL with * in it means, sorted."""
        system, path = self._resolved()
        return [Place(_shown(system, found)) for found in sorted(system.glob(path))]

    @property
    def exists(self) -> bool:
        """Whether there is something."""
        system, path = self._resolved()
        return bool(system.exists(path))

    def read(self) -> bytes:
        """A file's content. Raises InputError."""
        if (local := self.local) is not None:
            return read_bytes(local, _MOST_BYTES)
        system, path = self._resolved()
        try:
            return bytes(system.cat_file(path))
        except (OSError, ValueError) as error:
            raise InputError(f"{self.url}: cannot be read: {getattr(error, 'strerror', None) or error}") from error

    def read_all(self, ending: str) -> Mapping[str, bytes]:
        """All files below a folder whose names end so: their content by their path in it, without the ending."""
        system, path = self._resolved()
        if not system.exists(path):
            return {}
        found = [file for file in system.find(path) if file.endswith(ending)]
        content = system.cat(found) if len(found) > 1 else {file: system.cat_file(file) for file in found}
        start = len(path.rstrip("/")) + 1
        return {file[start : -len(ending)]: bytes(data) for file, data in content.items()}

    def write(self, data: bytes) -> None:
        """Make a file, whole or not at all; folders on the way are made. Raises OSError, InputError."""
        if (local := self.local) is not None:
            with new_file(local, overwrite=True) as partial:
                partial.write_bytes(data)
            return
        system, path = self._resolved()
        system.makedirs(path.rpartition("/")[0], exist_ok=True)
        system.pipe_file(path, data)

    @contextmanager
    def fetched(self) -> Iterator[Path]:
        """The folder as one of this machine, for as long as the context lasts. Raises OSError."""
        if (local := self.local) is not None:
            yield local
            return
        system, path = self._resolved()
        with TemporaryDirectory(prefix="roomscan-") as scratch:
            copy = Path(scratch) / path.rstrip("/").rpartition("/")[2]
            system.get(path.rstrip("/") + "/", f"{copy}/", recursive=True)
            yield copy

    @contextmanager
    def delivered(self) -> Iterator[Path]:
        """A folder of this machine to make; what is in it when the context ends is put in this place.

        Also if it ends with an error: a refusal leaves a result, too. Raises OSError.
        """
        if (local := self.local) is not None:
            yield local
            return
        system, path = self._resolved()
        with TemporaryDirectory(prefix="roomscan-") as scratch:
            made = Path(scratch) / "made"
            try:
                yield made
            finally:
                if made.exists():
                    system.put(f"{made}/", path.rstrip("/") + "/", recursive=True)

    def remove(self) -> None:
        """Take away a folder with what is in it. Raises OSError."""
        system, path = self._resolved()
        system.rm(path, recursive=True)

    def _resolved(self) -> tuple[fsspec.AbstractFileSystem, str]:
        try:
            system, path = fsspec.url_to_fs(self.url)
        except (ImportError, ValueError, OSError) as error:
            raise InputError(f"{self.url}: cannot be reached: {error}") from error
        return system, str(path)


def _shown(system: fsspec.AbstractFileSystem, path: str) -> str:
    """A path as a URL, but of this machine as it is."""
    return path if isinstance(system, LocalFileSystem) else str(system.unstrip_protocol(path))
