"""A comparison's folder is looked at: its points with their deviations, the legend, and the verdict."""

from pathlib import Path

import numpy as np
import pytest

from scanner.errors import InputError
from scanner.rendering import SIGNED
from scanner.viewing.colouring import Colouring, coloured, possible_colourings
from scanner.viewing.deviations import deviation_cloud, is_comparison
from tests.support.blob import Blob
from tests.support.command_line import run
from tests.support.surface_files import write_cloud, write_mesh


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compared")
    write_mesh(folder / "cad.stl", Blob())
    write_cloud(folder / "dented.ply", *Blob(dent=0.2).cloud(40_000, 2, (0.3, 0.1, 1)), seed=1)
    given = folder / "dented.ply", folder / "cad.stl"
    assert run("compare", *given, "--unit", "mm", "--tolerance", "0.1mm", "--out", folder / "out", "--quiet") == 1
    return folder / "out"


def test_colours_are_the_deviations_up_to_the_tolerance(compared: Path) -> None:
    assert is_comparison(compared)
    cloud, verdict = deviation_cloud(compared)
    assert possible_colourings(cloud) == (Colouring.REFERENCE,)
    deepest = int(np.nanargmin(cloud.deviation))
    assert -0.3 < cloud.deviation[deepest] < -0.17
    paint = coloured(cloud, np.array([deepest]), Colouring.REFERENCE)
    assert paint.colours[0].tolist() == SIGNED[0].tolist()
    assert paint.bar is not None
    assert (paint.bar.low, paint.bar.high) == ("−0.100 mm", "+0.100 mm")
    assert verdict.grade == "refused"
    assert verdict.headline.startswith("Fail")


def test_damaged_comparisons_are_refused(compared: Path, tmp_path: Path) -> None:
    assert not is_comparison(tmp_path)
    (tmp_path / "compare.json").write_text("{}")
    (tmp_path / "deviation.ply").write_bytes((compared / "deviation.ply").read_bytes())
    with pytest.raises(InputError, match="damaged files"):
        deviation_cloud(tmp_path)
