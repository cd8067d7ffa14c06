"""An import that is killed, interrupted, or meets a full disk leaves nothing that looks complete; a repetition
succeeds.
"""

from pathlib import Path

import numpy as np
import pytest

from scanner.capture import open_capture
from scanner.io import write_png
from scanner.patterns import draw
from tests.support.fault_bench import FaultBench
from tests.support.foreign_captures import ENDS, bits

SIZE = (640, 480)
SHOWN = [*bits("x", 10), *bits("y", 9), *ENDS]
COPYING = {"at": "scanner.importing.capture_folder:copy_given", "call": 20}
LISTING = {"at": "scanner.importing.capture_folder:flow_yaml"}
SYNCING = {"at": "scanner.results.result_folder:sync_tree"}
PUBLISHING = {"at": "scanner.results.result_folder:publish"}

pytestmark = pytest.mark.xdist_group("faults")


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of a camera at the projector's position."""
    folder: Path = tmp_path_factory.mktemp("foreign")
    for number, pattern in enumerate(SHOWN):
        write_png(folder / f"pattern_cam1_im{number + 1}.png", (draw(pattern, SIZE) // 2 + 20).astype(np.uint8))
    return folder


def is_whole(capture: Path, frames: Path) -> bool:
    copied = {path.name: path.read_bytes() for path in (capture / "frames").iterdir()}
    return open_capture(capture).patterns == tuple(SHOWN) and copied == {
        path.name: path.read_bytes() for path in frames.iterdir()
    }


@pytest.mark.parametrize("fault", ["SIGKILL", "SIGTERM"])
@pytest.mark.parametrize("moment", [LISTING, COPYING, SYNCING, PUBLISHING], ids=lambda moment: moment["at"])
def test_an_import_is_interrupted(
    bench: FaultBench, frames: Path, tmp_path: Path, fault: str, moment: dict[str, object]
) -> None:
    out = tmp_path / "capture"
    command = ("import", frames, "--from", "opencv", "--out", out)
    ended = bench.run(tmp_path, *command, faults=[{**moment, "do": fault}])
    # What is whole is published: at once if the program was asked to end, by the next one if it was killed.
    settled = moment == PUBLISHING or (moment == SYNCING and fault == "SIGTERM")
    assert ended.code == (-9 if fault == "SIGKILL" else 130)
    assert "Traceback" not in ended.said
    assert out.exists() == (settled and fault == "SIGTERM")
    again = bench.run(tmp_path, *command)
    assert again.code == (2 if settled else 0), again.said
    assert is_whole(out, frames)
    left = {path.name for path in tmp_path.iterdir()} - {"said.txt"}
    assert left == {"capture"}


@pytest.mark.parametrize("options", ["size=12k", "size=400k", "size=2m,nr_inodes=20"])
def test_an_import_onto_a_full_disk(bench: FaultBench, frames: Path, tmp_path: Path, options: str) -> None:
    where = tmp_path / "disk"
    where.mkdir()
    mount = {"where": where, "options": options}
    ended = bench.run(tmp_path, "import", frames, "--from", "opencv", "--out", where / "capture", mount=mount)
    assert ended.code == 3, ended.said
    assert str(where / "capture") in ended.said
    assert "Traceback" not in ended.said
    assert ended.files == {}
