"""A local folder or a remote one: any location that fsspec reads and writes, such as s3://bucket/folder."""

import glob
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

from hw.optional_parts import BATCH
from scanner.errors import InputError
from scanner.io import new_file, read_bytes

if TYPE_CHECKING:
    import fsspec

_MOST_BYTES = 200_000_000  # a list of a million captures


@dataclass(frozen=True)
class Location:
    """A folder or a file, by its URL or its path."""

    url: str

    def __truediv__(self, name: str) -> "Location":
        return Location(f"{self.url.rstrip('/')}/{name}")

    @property
    def local(self) -> Path | None:
        """Its path on this machine; None if it is not on it."""
        scheme, separator, path = self.url.rpartition("://")
        if separator and scheme != "file":
            return None
        return Path(os.path.abspath(path))  # noqa: PTH100 (links stay what they are)

    @property
    def parts(self) -> tuple[str, ...]:
        """The folders on the way, however the URL writes them, and its own name."""
        path = str(self.local) if self.local else self._resolved()[1]
        return tuple(path.strip("/").split("/"))

    def walk(self) -> Iterator[tuple["Location", list[str], list[str]]]:
        """Walk the tree from the top, like `os.walk`: folders that the caller removes from the list are not entered."""
        if self.local:
            for folder, folders, files in os.walk(self.local):
                yield Location(folder), folders, files
            return
        system, path = self._resolved()
        for folder, folders, files in cast(Any, system).walk(path, topdown=True):
            yield Location(str(system.unstrip_protocol(folder))), folders, files

    def glob(self) -> list["Location"]:
        """Return the sorted locations that match a URL with *."""
        if self.local:
            return [Location(path) for path in sorted(glob.glob(str(self.local), recursive=True))]  # noqa: PTH207
        system, path = self._resolved()
        return [Location(str(system.unstrip_protocol(file))) for file in sorted(system.glob(path))]

    @property
    def exists(self) -> bool:
        """Whether there is something."""
        if self.local:
            return self.local.exists()
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
        if local := self.local:
            return {
                str(file.relative_to(local))[: -len(ending)]: Location(str(file)).read()
                for file in local.rglob(f"*{ending}")
                if file.is_file()
            }
        system, path = self._resolved()
        if not system.exists(path):
            return {}
        files = [file for file in system.find(path) if file.endswith(ending)]
        content = system.cat(files) if len(files) > 1 else {file: system.cat_file(file) for file in files}
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
        """A local folder to fill; when the context ends, its content is moved to this location.

        Also after an error, because a refusal has a result, too. Raises OSError.
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
        """Remove a remote folder with its content. Raises OSError."""
        system, path = self._resolved()
        system.rm(path, recursive=True)

    def _resolved(self) -> "tuple[fsspec.AbstractFileSystem, str]":
        """The file system and the path in it, of a place that is not on this machine. Raises InputError."""
        with BATCH.needed(f"{self.url}: what is not a folder of this machine", "fsspec", InputError):
            import fsspec
        try:
            system, path = fsspec.url_to_fs(self.url)
        except (ImportError, ValueError, OSError) as error:
            raise InputError(f"{self.url}: cannot be reached: {error}") from error
        return system, str(path)
