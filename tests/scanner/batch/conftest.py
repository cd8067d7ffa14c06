"""Captures that all batches of these tests take."""

import shutil
from pathlib import Path

import pytest

from scanner.commands import main
from tests.support.small_capture import CONFIG, with_few_rays


@pytest.fixture(scope="session")
def museum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two captures of a room, a dark one that is refused, one whose frames are missing, and the configuration."""
    folder = tmp_path_factory.mktemp("museum")
    (folder / "room.yaml").write_text(CONFIG)
    scans, scan = folder / "scans", ("--config", str(folder / "room.yaml"), "--quiet", "--out")
    with pytest.MonkeyPatch.context() as patch:
        with_few_rays(patch)
        assert main([*scan, str(scans / "one")]) == 0
        assert main([*scan, str(scans / "dark"), "--set", "rig.exposure_us=1000"]) == 4
    captures = folder / "captures"
    for name, source in (("hall/one", "one"), ("hall/two", "one"), ("dark", "dark"), ("broken", "one")):
        shutil.copytree(scans / source / "capture", captures / name)
    for path in (captures / "broken" / "frames").iterdir():
        path.unlink()
    return folder
