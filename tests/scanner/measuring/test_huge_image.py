"""Few points in a huge image take the memory of few points."""

import json
import tracemalloc
from pathlib import Path

import pytest

from tests.support.cloud_scene import SPHERE_RADIUS_M
from tests.support.command_line import run
from tests.support.result_folder import enlarge, write_result


@pytest.mark.parametrize("factor", [1, 30])
def test_a_ball_is_measured_in_an_image_of_126_megapixels(tmp_path: Path, factor: int) -> None:
    written = write_result(tmp_path / "room")
    enlarge(tmp_path / "room", factor)
    tracemalloc.start()
    try:
        assert run("measure", tmp_path / "room", "--sphere", 2 * SPHERE_RADIUS_M, "--quiet") == 0
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    (sphere,) = json.loads((tmp_path / "room-measured" / "measure.json").read_text(encoding="utf-8"))["spheres"]
    assert sphere["diameter"] == pytest.approx(2 * SPHERE_RADIUS_M, abs=1e-3)
    assert sphere["centre"] == pytest.approx(written.scene.sphere_centre, abs=1e-3)
    assert peak < 600_000_000
