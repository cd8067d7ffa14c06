"""For tests that begin with a recording."""

from pathlib import Path

import pytest
from small_capture import write_capture


@pytest.fixture
def capture_folder(tmp_path: Path) -> Path:
    """The smallest capture folder."""
    return write_capture(tmp_path / "room")
