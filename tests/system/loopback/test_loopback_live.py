"""Live clouds through the real path: pipelined pictures, triggers, packets."""

from pathlib import Path

import numpy as np
import pytest

from hw.simulated import SimulatedRoom
from scanner.commands import main
from scanner.io import read_matches, write_calibration
from tests.support.loopback_bench import Loopback

pytestmark = pytest.mark.xdist_group("loopback")


def test_errors_of_live_clouds_match_their_sigmas(
    tmp_path: Path, config: Path, rig: Loopback, room: SimulatedRoom
) -> None:
    assert room.calibration is not None
    write_calibration(tmp_path / "true.yaml", room.calibration)
    out = tmp_path / "live"
    given = ["--config", str(config), "--calibration", str(tmp_path / "true.yaml")]
    assert main(["live", *given, "--clouds", "3", "--out", str(out), "--quiet"]) == 0
    true_px = room.ground_truth().projector_px
    for station in ("1", "2", "3"):
        matches = read_matches(out / "captures" / station)
        column, row = matches.camera_px.astype(np.int64).T
        off = np.linalg.norm(matches.projector_px - true_px[row, column], axis=1)
        assert len(matches) > 10_000
        assert matches.sigma_px is not None
        assert 0.8 < np.nanquantile(off / matches.sigma_px, 0.683) < 1.4
        assert np.nanmean(off > 10) < 0.01  # a period off
