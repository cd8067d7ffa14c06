"""Settings of the page override the configuration file."""

import os
from pathlib import Path

import numpy as np
import pytest

from hw.aravis.settings import AravisRigSettings
from scanner.console.results import earlier_results
from scanner.console.settings import Picture, Settings, drawn
from scanner.errors import InputError
from scanner.patterns.pattern import sequence_for

CONFIG = "rig: {backend: aravis, exposure_us: 1000}\ncamera: {width: 32, height: 24}\n"


def test_the_page_overrides_the_command_line_and_the_file(tmp_path: Path) -> None:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    assert Settings(path).load().required_rig.exposure_us == 1000
    overridden = Settings(path, ("rig.exposure_us=2000",))
    assert overridden.load().required_rig.exposure_us == 2000
    changed = Settings(path, ("rig.exposure_us=2000",), exposure_us=3000.5, gain=-1.5).load().required_rig
    assert isinstance(changed, AravisRigSettings)
    assert (changed.exposure_us, changed.gain) == (3000.5, -1.5)


def test_an_impossible_exposure_is_refused_as_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    with pytest.raises(InputError, match="exposure_us"):
        Settings(path, exposure_us=-5.0).load()


@pytest.mark.parametrize(("picture", "levels"), [(Picture.WHITE, {255}), (Picture.BLACK, {0})])
def test_plain_pictures_are_offered(picture: Picture, levels: set[int]) -> None:
    image = drawn(picture, sequence_for((64, 48), cell=8, shifts=3), (64, 48))
    assert image.shape == (48, 64)
    assert set(np.unique(image)) == levels


def test_stripes_are_offered_with_and_without_fringes() -> None:
    for shifts in (0, 3):
        image = drawn(Picture.STRIPES, sequence_for((64, 48), cell=8, shifts=shifts), (64, 48))
        assert image.max() > 200
        assert image.min() < 50


def test_earlier_results_are_listed_newest_first(tmp_path: Path) -> None:
    assert earlier_results(tmp_path / "scans") == ()
    for age, (name, file) in enumerate((("new", "matches.npz"), ("thing", "object.yaml"), ("old", "room.yaml"))):
        folder = tmp_path / "scans" / name
        folder.mkdir(parents=True)
        (folder / file).touch()
        (folder / "scan.log").touch()
        os.utime(folder / "scan.log", (1e9 - age, 1e9 - age))
    (tmp_path / "scans" / "foreign").mkdir()
    assert [path.name for path in earlier_results(tmp_path / "scans")] == ["new", "thing", "old"]
