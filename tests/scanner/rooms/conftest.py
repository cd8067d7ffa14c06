"""A simulated whole room as matches files: four of its stations, an open chain, in random order."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from scanner.configuration import Config
from scanner.io import write_matches
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.jobs import scan_room
from tests.support.whole_room import PROJECTOR, TrueStation, stations

CAMERA = (306, 256)
ORDER = (2, 0, 3, 1)  # nobody has to know the order


@dataclass(frozen=True)
class SolvedExample:
    """`true` and `solved` are in the same order; `out` is the result folder, `files` its input."""

    true: Sequence[TrueStation]
    solved: SolvedRoom
    out: Path
    files: Sequence[Path]
    config: Config


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run these tests in one process, which solves the example once."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.xdist_group("rooms"))


@pytest.fixture(scope="session")
def example(tmp_path_factory: pytest.TempPathFactory) -> SolvedExample:
    pytest.importorskip("open3d", exc_type=ImportError)
    folder = tmp_path_factory.mktemp("room")
    found = stations(6, 1, camera=CAMERA, furniture_askew_deg=4.0)
    true = [found[k] for k in ORDER]
    files = []
    for number, station in enumerate(true):
        files.append(folder / f"station-{number}.npz")
        write_matches(files[-1], station.matches)
    calibration = true[0].calibration
    config = Config.model_validate(
        {
            "camera": {"width": CAMERA[0], "height": CAMERA[1], "principal_point": {"prior": "centre", "sigma_px": 18}},
            "projector": {"width": PROJECTOR[0], "height": PROJECTOR[1]},
            "lens": {"decentering": 0.0, "k3": 0.0},
            "scale": {"baseline_m": calibration.baseline},
        }
    )
    out = folder / "room"
    return SolvedExample(true, scan_room(config, out, stations=files), out, files, config)
