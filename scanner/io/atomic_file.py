"""Files that appear whole or not at all, and never over others unless that is asked for."""

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from scanner.errors import InputError, cannot_write


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise InputError if `path` is anything but a file that may be replaced."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected the name of a file to write")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: already exists; choose another --out, or replace it with --overwrite")


@contextmanager
def new_files(folder: Path, names: Sequence[str], *, overwrite: bool) -> Iterator[list[Path]]:
    """Several of them that belong together, all of them or none; else as `new_file`."""
    with ExitStack() as together:
        yield [together.enter_context(new_file(folder / name, overwrite=overwrite)) for name in names]


@contextmanager
def new_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """A hidden file beside `path` to write into; it becomes `path` when the block ends well, and vanishes if not.

    Folders on the way are made. Raises InputError if `path` exists and may not be replaced, or no file can be there;
    StorageError if the disk does not take it.
    """
    refuse_existing(path, overwrite=overwrite)
    partial = path.with_name(f".{os.getpid()}.partial.{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(path.parent, error, "made") from error
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with suppress(OSError):  # of a disk that takes nothing, which is said already
            partial.unlink(missing_ok=True)
