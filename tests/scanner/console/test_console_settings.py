"""Settings of the page override the configuration file."""

import os
from pathlib import Path

import numpy as np
import pytest

from hw.aravis import AravisRigSettings
from scanner.console.results import earlier_results
from scanner.console.settings import ConsoleSettings, IdlePicture, drawn
from scanner.errors import InputError
from scanner.patterns import sequence_for

CONFIG = "rig: {backend: aravis, exposure_us: 1000}\ncamera: {width: 32, height: 24}\n"


def test_the_page_overrides_the_command_line_and_the_file(tmp_path: Path) -> None:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    assert ConsoleSettings(path).load().required_rig.exposure_us == 1000
    overridden = ConsoleSettings(path, ("rig.exposure_us=2000",))
    assert overridden.load().required_rig.exposure_us == 2000
    changed = ConsoleSettings(path, ("rig.exposure_us=2000",), exposure_us=3000.5, gain=-1.5).load().required_rig
    assert isinstance(changed, AravisRigSettings)
    assert (changed.exposure_us, changed.gain) == (3000.5, -1.5)


def test_an_impossible_exposure_is_refused_as_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    with pytest.raises(InputError, match="exposure_us"):
        ConsoleSettings(path, exposure_us=-5.0).load()


NETWORK = CONFIG + "rigs: {cameras: {left: {}, right: {rig: {exposure_us: 500}}}, projectors: {stage: {}, side: {}}}\n"


@pytest.mark.parametrize(
    ("pair", "exposures"),
    [(None, {"left": 3000, "right": 3000}), (("left", "stage"), {"left": 3000, "right": 500})],
)
def test_exposure_setting_applies_to_the_cameras_in_view(
    pair: tuple[str, str] | None, exposures: dict[str, float], tmp_path: Path
) -> None:
    path = tmp_path / "hall.yaml"
    path.write_text(NETWORK)
    pairs = ConsoleSettings(path, pair=pair, exposure_us=3000).load_whole().pairs
    for (camera, _), config in pairs.items():
        assert config.required_rig.exposure_us == exposures[camera]


def test_network_view_cycles_through_cameras_or_shows_the_chosen_pair(tmp_path: Path) -> None:
    path = tmp_path / "hall.yaml"
    path.write_text(NETWORK)
    settings = ConsoleSettings(path)
    assert [each.pair for each in settings.in_turn()] == [("left", "stage"), ("right", "stage")]
    assert [each.load().required_rig.exposure_us for each in settings.in_turn()] == [1000, 500]
    chosen = ConsoleSettings(path, pair=("right", "side"))
    assert chosen.in_turn() == (chosen,)
    assert chosen.rig_key == "rigs.cameras.right.rig"
    with pytest.raises(InputError, match="choose a camera and a projector"):
        settings.load()
    with pytest.raises(InputError, match="names no camera third with a projector stage any more"):
        ConsoleSettings(path, pair=("third", "stage")).load()


@pytest.mark.parametrize(("picture", "levels"), [(IdlePicture.WHITE, {255}), (IdlePicture.BLACK, {0})])
def test_plain_pictures_are_offered(picture: IdlePicture, levels: set[int]) -> None:
    image = drawn(picture, sequence_for((64, 48), cell=8, shifts=3), (64, 48))
    assert image.shape == (48, 64)
    assert set(np.unique(image)) == levels


def test_stripes_are_offered_with_and_without_fringes() -> None:
    for shifts in (0, 3):
        image = drawn(IdlePicture.STRIPES, sequence_for((64, 48), cell=8, shifts=shifts), (64, 48))
        assert image.max() > 200
        assert image.min() < 50


def test_earlier_results_are_listed_newest_first(tmp_path: Path) -> None:
    assert earlier_results(tmp_path / "scans") == ()
    files = {
        "new": "matches.npz",
        "hall": "network.yaml",
        "thing": "object.yaml",
        "no": "refused.yaml",
        "old": "room.yaml",
    }
    for age, (name, file) in enumerate(files.items()):
        folder = tmp_path / "scans" / name
        folder.mkdir(parents=True)
        (folder / file).touch()
        (folder / "scan.log").touch()
        os.utime(folder / "scan.log", (1e9 - age, 1e9 - age))
    (tmp_path / "scans" / "foreign").mkdir()
    assert [path.name for path in earlier_results(tmp_path / "scans")] == [*files]
