"""One simulated room for all imports."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.foreign_captures import CAMERA, FOREIGN, PROJECTOR, Photographer, photographer


@pytest.fixture(scope="session")
def camera() -> Photographer:
    return photographer(CAMERA, PROJECTOR)


@pytest.fixture(scope="session")
def folder(camera: Photographer, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The frames of one of FOREIGN, and copies to damage."""
    kept = {}

    def of(name: str) -> Path:
        if name not in kept:
            case, place = FOREIGN[name], tmp_path_factory.mktemp("foreign") / "frames"
            kept[name] = camera.write(place, case.patterns, case.names, case.change)
        copy: Path = tmp_path_factory.mktemp("copy") / "frames"
        return Path(shutil.copytree(kept[name], copy))

    return of
