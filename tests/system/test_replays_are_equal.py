"""Replays of one capture are equal bit for bit, on any number of processors."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib.numerics import processors, use_processors
from scanner.commands import main
from tests.support.small_capture import CONFIG, with_few_rays

NUMBERS = ("cloud.ply", "matches.npz", "calibration.yaml")
_OF_A_RUN = re.compile(rb"^ +(?:date|name|command): .*\n", re.M)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scanned")
    config = folder / "room.yaml"
    config.write_text(CONFIG)
    with pytest.MonkeyPatch.context() as patch:
        with_few_rays(patch)
        assert main(["--config", str(config), "--out", str(folder / "out"), "--quiet"]) == 0
    return folder / "out" / "capture"


@pytest.fixture
def _as_before() -> Iterator[None]:
    before = processors()
    yield
    use_processors(before)


@pytest.mark.usefixtures("_as_before")
def test_replays_are_equal(capture: Path, tmp_path: Path) -> None:
    contents = []
    for number, count in enumerate((1, 1, 2, 5)):
        use_processors(count)
        out = tmp_path / f"replay-{number}"
        config = capture.parents[1] / "room.yaml"
        assert main(["replay", str(capture), "--config", str(config), "--out", str(out), "--quiet"]) == 0
        contents.append([_OF_A_RUN.sub(b"", (out / name).read_bytes()) for name in NUMBERS])
    for name, *versions in zip(NUMBERS, *contents, strict=True):
        assert all(version == versions[0] for version in versions[1:]), name
        assert len(versions[0]) > 1000
