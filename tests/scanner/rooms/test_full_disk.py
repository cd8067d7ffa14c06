"""A full disk while a room is written: the path is named, and nothing incomplete remains."""

from pathlib import Path

import pytest

from scanner.configuration import Config
from scanner.errors import StorageError
from scanner.results import new_result
from scanner.rooms.save import save_room
from scanner.ui import Terminal
from tests.scanner.rooms.conftest import SolvedExample
from tests.support.little_memory import no_file_larger_than


def test_a_full_disk_leaves_no_incomplete_room(example: SolvedExample, tmp_path: Path) -> None:
    out = tmp_path / "room"
    with (
        pytest.raises(StorageError) as caught,
        new_result(out, Config(), overwrite=False) as folder,
        no_file_larger_than(1_000_000),
    ):
        save_room(example.solved, folder, Config(), Terminal(quiet=True))
    assert str(out) in str(caught.value)
    assert "partial" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
