"""A given calibration is doubted only if the rig has changed since, and then with what changed and by how much."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnostics import Uncertainty
from calib.finding import Finding, Severity
from calib.geometry import Calibration, Matches, Pose, rotation_about
from calib.refinement import SHARED
from calib.scene.given_calibration import CALIBRATION_CHANGED, find_change
from calib.synthetic import random_captures
from tests.support.things import thing_stations, true_rig

_NOISE_PX = 0.05
SEEDS = range(8)


def before_corner(seed: int) -> tuple[Calibration, Matches]:
    """A rig, and matches of a corner."""
    (capture,) = random_captures(np.random.default_rng([seed, 57]), 1, count=20_000, noise_px=_NOISE_PX)
    return capture.calibration, capture.matches


def before_thing(seed: int) -> tuple[Calibration, Matches]:
    """A rig, and matches of a lump on a table."""
    (station,) = thing_stations([seed], (306, 256), seed=seed)
    return station.calibration, station.matches


def turned(calibration: Calibration, degrees: tuple[float, float, float]) -> Calibration:
    turn = rotation_about(np.radians(degrees))
    return replace(calibration, pose=Pose(turn @ calibration.pose.rotation, calibration.pose.translation))


def zoomed(calibration: Calibration, factor: float) -> Calibration:
    fx, fy = calibration.projector.focal_px
    return replace(calibration, projector=replace(calibration.projector, focal_px=(factor * fx, factor * fy)))


def stated(calibration: Calibration, *, focal: float) -> Uncertainty:
    """That of a calibration with independent errors, of a share `focal` in both focal lengths."""
    device = [focal, 1.0, 1.0, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5]
    sigma = np.array([*device, *device, *[1e-4] * 5])
    assert len(sigma) == SHARED
    return Uncertainty(true_rig(calibration), np.diag(sigma**2), None, _NOISE_PX)


def warning_on(calibration: Calibration, known: Uncertainty | None, matches: Matches) -> Finding:
    """The only finding."""
    (finding,) = find_change(calibration, known, [matches])
    assert (finding.kind, finding.severity) == (CALIBRATION_CHANGED, Severity.WARNING)
    assert finding.number("given_px") > finding.number("excess_px") > 0.15
    assert 0.7 * _NOISE_PX < finding.number("best_px") < 2 * _NOISE_PX
    return finding


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("scene", [before_corner, before_thing])
def test_an_unchanged_rig_says_nothing(scene: type, seed: int) -> None:
    calibration, matches = scene(seed)
    assert find_change(calibration, None, [matches]) == ()
    assert find_change(calibration, stated(calibration, focal=1e-4), [matches, matches]) == ()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("degrees", [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.3)])
def test_a_turned_projector_is_named_with_its_amount(degrees: tuple[float, float, float], seed: int) -> None:
    calibration, matches = before_corner(seed)
    given = turned(calibration, degrees)
    finding = warning_on(given, stated(given, focal=1e-5), matches)
    assert "A change of the rotation between them by 0.3° ± 0.0" in finding.message


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("factor", [1.005, 0.995])
def test_a_zoomed_projector_is_named_with_its_amount(factor: float, seed: int) -> None:
    calibration, matches = before_corner(seed)
    finding = warning_on(zoomed(calibration, factor), None, matches)
    assert "A change of the projector's focal length by 0.5 % ± 0.0" in finding.message


def test_what_its_sigmas_explain_is_no_change() -> None:
    calibration, matches = before_corner(1)
    given = zoomed(calibration, 1.005)
    assert find_change(given, stated(given, focal=1e-5), [matches]) != ()
    assert find_change(given, stated(given, focal=5e-3), [matches]) == ()


def test_a_few_matches_say_nothing() -> None:
    calibration, matches = before_corner(1)
    assert find_change(turned(calibration, (0.3, 0.0, 0.0)), None, [matches[np.arange(499)]]) == ()
    assert find_change(turned(calibration, (0.3, 0.0, 0.0)), None, []) == ()
