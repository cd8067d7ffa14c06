"""A rig whose live clouds begin says whether its calibration still holds, also while something moves."""

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnostics import Uncertainty
from calib.geometry import Calibration, Pose, rotation_about
from calib.refinement import SHARED
from calib.scene import CALIBRATION_CHANGED
from scanner.configuration import Config
from scanner.live.first_look import look
from scanner.live.given_calibration import find_change_live
from scanner.live.rounds import best_sequence
from tests.support.live_bench import LiveBench
from tests.support.things import true_rig

_CERTAIN = 1e-10 * np.eye(SHARED)


def changed(calibration: Calibration, turn_deg: tuple[float, float, float], zoom: float) -> Calibration:
    turn = rotation_about(np.radians(turn_deg))
    (fx, fy) = calibration.projector.focal_px
    return replace(
        calibration,
        projector=replace(calibration.projector, focal_px=(zoom * fx, zoom * fy)),
        pose=Pose(turn @ calibration.pose.rotation, calibration.pose.translation),
    )


def told(bench: LiveBench, given: Calibration) -> list[str]:
    """The warnings under a calibration that is certain of itself."""
    first = look(bench.rig, Config())
    sequence = best_sequence(bench.rig, first, given, None)
    findings = find_change_live(bench.rig, sequence, first, given, Uncertainty(true_rig(given), _CERTAIN, None, 0.05))
    assert {finding.kind for finding in findings} <= {CALIBRATION_CHANGED}
    return [finding.message for finding in findings]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "odd", [{}, {"gamma": 1.8}, {"bounce": 0.15}, {"speed_m": (2e-4, 1e-4, 0.0)}, {"speed_m": (0.0, 0.0, -1e-3)}]
)
def test_an_unchanged_rig_says_nothing(odd: dict[str, object], seed: int) -> None:
    bench = LiveBench(seed=seed, **odd)  # type: ignore[arg-type]
    assert told(bench, bench.calibration) == []


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("turn_deg", [(0.3, 0.0, 0.0), (0.0, 0.0, 0.3)])
def test_a_turned_projector_is_named_with_its_amount(turn_deg: tuple[float, float, float], seed: int) -> None:
    bench = LiveBench(seed=seed)
    (message,) = told(bench, changed(bench.calibration, turn_deg, 1.0))
    assert "A change of the rotation between them by 0.3° ± 0.0" in message


def test_a_zoomed_projector_is_named_with_its_amount() -> None:
    bench = LiveBench(seed=1)
    (message,) = told(bench, changed(bench.calibration, (0.0, 0.0, 0.0), 1.01))
    assert re.search(r"A change of the projector's focal length by (1|1\.01|0\.99) % ± 0\.0", message)
