"""One room and one video for all recordings."""

from pathlib import Path

import pytest
from filming import Camera

from tests.support.room import BIT_RATE, FilmedRoom


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> FilmedRoom:
    return FilmedRoom(tmp_path_factory.mktemp("filmed"))


@pytest.fixture(scope="session")
def recording(filmed: FilmedRoom) -> Path:
    """A recording by a phone at 30 frames a second."""
    return filmed.film("phone.mp4", Camera(bit_rate=BIT_RATE))
