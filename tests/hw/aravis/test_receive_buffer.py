"""The receive buffer holds whole frames if the system permits."""

from pathlib import Path

import pytest

from hw.aravis.setup import receive_buffer


@pytest.mark.parametrize(
    ("limit", "kept"), [("4194304\n", 1_200_000), ("1200000\n", 1_200_000), ("212992\n", None), ("", None)]
)
def test_the_buffer_holds_four_frames_or_the_default(tmp_path: Path, limit: str, kept: int | None) -> None:
    file = tmp_path / "rmem_max"
    file.write_text(limit)
    assert receive_buffer(300_000, file) == kept


def test_systems_without_a_limit_file_use_the_default(tmp_path: Path) -> None:
    assert receive_buffer(300_000, tmp_path / "none") is None
