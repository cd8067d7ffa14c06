"""Folders that were created for files that could not be written."""

from pathlib import Path

import pytest

from scanner.errors import InputError, StorageError
from scanner.io import new_files

NAMES = ("one", "two")


def write(folder: Path, *, fail: bool) -> None:
    with new_files(folder, NAMES, overwrite=False) as paths:
        paths[0].write_text("1")
        if fail:
            raise OSError(28, "No space left on device")
        paths[1].write_text("2")


def test_after_a_failure_new_folders_are_removed(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="No space left"):
        write(tmp_path / "a" / "b", fail=True)
    assert list(tmp_path.iterdir()) == []


def test_after_a_failure_existing_folders_are_kept(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "empty").mkdir()
    (tmp_path / "a" / "note").write_text("mine")
    for folder in (tmp_path / "a" / "b", tmp_path / "a", tmp_path / "empty"):
        with pytest.raises(StorageError):
            write(folder, fail=True)
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")}
    assert found == {"a", "a/note", "empty"}


def test_after_a_failed_mkdir_new_parents_are_removed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be made"):
        write(tmp_path / "a" / ("b" * 300), fail=False)
    assert list(tmp_path.iterdir()) == []


def test_after_success_the_files_stay(tmp_path: Path) -> None:
    write(tmp_path / "a" / "b", fail=False)
    assert {path.name for path in (tmp_path / "a" / "b").iterdir()} == set(NAMES)
