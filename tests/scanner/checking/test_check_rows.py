"""The rows of a check of a simulated rig, compared with the truth."""

import re
import time
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.geometry import Matches, PixelGrid
from calib.refusal import RefusalError
from hw.errors import DeviceError
from hw.rig import Capabilities, Frame, Rig, exposure_control
from hw.simulated import SimulatedCamera, SimulatedRoom
from scanner.acquisition import decode
from scanner.capture import capture
from scanner.checking import view
from scanner.checking.check import check_rig
from scanner.checking.exposure import exposure_levels, exposure_row, propose_exposure
from scanner.checking.fringes import FringeMeter
from scanner.checking.light import Light, ambient_share, flicker_of, ghost_of, light_rows, photograph_light
from scanner.checking.report import CheckReport, CheckRow, CheckState
from scanner.checking.response import measure_ramp, pixel_row, ramp_of, response_row
from scanner.checking.steadiness import InitialState, levels_of, patterns, row_of, steadiness_row
from scanner.decoding import Decoding
from scanner.decoding.motion import RigidFit
from scanner.patterns import ProjectorResponse
from scanner.quantities import relative_focal_sigmas
from scanner.reconstruction import label, solve
from scanner.ui import Terminal
from tests.support.rig_bench import PERIOD_US, PROJECTOR, changed, config, rig_in, row

pytestmark = pytest.mark.xdist_group("checking")

QUIET = Terminal(quiet=True)
WHITE = np.full(PROJECTOR[::-1], 255, np.uint8)
NAMES = [
    *("camera", "projector", "latency", "exposure", "ambient light", "flicker", "ghost", "response", "pixels"),
    *("coverage", "focus", "steadiness", "view"),
]


def test_a_good_rig_is_ok_in_every_row(usual: CheckReport) -> None:
    assert [row.name for row in usual.rows] == NAMES
    assert {row.name: row.state for row in usual.rows if row.state != CheckState.OK} == {}
    assert usual.failure is None
    assert not any(row.finding.advice for row in usual.rows)
    assert set(usual.pictures) == {"saturation", "coverage", "contrast"}


def test_rows_come_one_by_one(usual: CheckReport, rows_of_usual: list[CheckRow]) -> None:
    assert rows_of_usual == usual.rows


def test_coverage_matches_the_true_view(room: SimulatedRoom) -> None:
    truth = room.ground_truth().projector_px
    lit = float(np.isfinite(truth).all(axis=2).mean())
    quick = view.take_quick(rig_in(room), config(), FringeMeter(), QUIET)
    coverage = view.coverage_of(quick.decoding, PROJECTOR)
    assert lit - 0.03 < coverage.camera < lit + 0.005
    squares = truth[np.isfinite(truth).all(axis=2)] / np.array(PROJECTOR) * (32, 18)
    seen = np.zeros((18, 32), bool)
    seen[tuple(squares[:, ::-1].astype(int).clip(0, (17, 31)).T)] = True
    assert coverage.projector == pytest.approx(seen.mean(), abs=0.04)
    area = seen.mean() * PROJECTOR[0] * PROJECTOR[1] / np.isfinite(truth).all(axis=2).sum()
    assert coverage.span == pytest.approx(np.sqrt(area), rel=0.1)


@pytest.mark.parametrize("start", [0.1, 0.4, 1.0, 2.5, 30.0])
def test_the_proposed_exposure_uses_the_range_and_saturates_nothing(room: SimulatedRoom, start: float) -> None:
    rig = rig_in(changed(room, exposure_us=start * room.sensor.exposure_us, refresh_hz=240.0))
    proposal = propose_exposure(rig)
    period_us = 1e6 / 240
    assert proposal.exposure_us == exposure_control(rig.camera).exposure_us
    assert proposal.exposure_us / period_us == pytest.approx(round(proposal.exposure_us / period_us))
    lit = np.isfinite(room.ground_truth().projector_px).all(axis=2)
    electrons = room.electrons(WHITE)[lit] * proposal.exposure_us / room.sensor.exposure_us
    brightest = float(np.quantile(electrons, 0.999)) / room.sensor.full_well_electrons
    assert 0.75 < brightest < 0.99
    found = exposure_row(proposal, 240.0, bracketed=False)
    assert found.state == (CheckState.OK if start == 1.0 else CheckState.POOR)
    if start > 2:
        assert "clipped" in found.finding.message
        assert "--write" in found.finding.advice


def test_an_exposure_that_cannot_be_short_enough_is_reported(room: SimulatedRoom) -> None:
    rig = rig_in(changed(room, exposure_us=100_000, refresh_hz=10.0))
    proposal = propose_exposure(rig)
    assert proposal.exposure_us is None
    found = exposure_row(proposal, 10.0, bracketed=False)
    assert found.state == CheckState.POOR
    assert "close the aperture" in found.finding.advice


@pytest.mark.parametrize(("part", "state"), [(0.2, CheckState.POOR), (1.0, CheckState.OK), (3.0, CheckState.POOR)])
def test_a_fixed_exposure_is_judged(
    monkeypatch: pytest.MonkeyPatch, room: SimulatedRoom, part: float, state: CheckState
) -> None:
    monkeypatch.setattr(SimulatedCamera, "capabilities", Capabilities())
    rig = rig_in(changed(room, exposure_us=part * room.sensor.exposure_us, refresh_hz=240.0))
    found = exposure_row(propose_exposure(rig), 240.0, bracketed=False)
    assert found.state == state
    assert ("by hand" in found.finding.advice) == (state == CheckState.POOR)


@pytest.mark.parametrize(("ambient", "state"), [(0.02, CheckState.OK), (0.3, CheckState.OK), (1.5, CheckState.POOR)])
def test_ambient_light(room: SimulatedRoom, ambient: float, state: CheckState) -> None:
    lit_room = changed(room, ambient=ambient)
    light = photograph_light(rig_in(lit_room), 2, 2)
    found = {row.name: row for row in light_rows(light)}["ambient light"]
    assert found.state == state
    assert ("Darken" in found.finding.advice) == (state == CheckState.POOR)
    dark, bright = (lit_room.electrons(np.full_like(WHITE, level)) for level in (0, 255))
    lit = np.isfinite(room.ground_truth().projector_px).all(axis=2)
    true = float(np.median(dark[lit] / bright[lit]))
    assert ambient_share(light) == pytest.approx(true, rel=0.15)


def test_pulsating_light_flickers_unless_exposures_are_whole_periods(room: SimulatedRoom) -> None:
    pulsating = changed(room, pulsation=0.3, exposure_us=1.5 * PERIOD_US)
    rig = rig_in(pulsating)
    light = photograph_light(rig, 24, 4)
    expected = 0.3 / (1.5 * np.pi) / np.sqrt(2)  # of 1 + m sinc(1.5) cos φ
    assert flicker_of(light).white == pytest.approx(expected, rel=0.35)
    found = {row.name: row for row in light_rows(light)}["flicker"]
    assert found.state == CheckState.POOR
    assert "projector" in found.finding.advice
    exposure_control(rig.camera).expose_for(2 * PERIOD_US)
    assert 1e-6 < flicker_of(photograph_light(rig, 6, 4)).white < 0.002
    advised = exposure_row(propose_exposure(rig_in(pulsating)), 60.0, bracketed=False)
    assert advised.state == CheckState.POOR
    assert "differ by" in advised.finding.message


@pytest.mark.parametrize("ghost", [0.0, 0.1])
def test_ghosting_of_the_last_picture_is_measured(room: SimulatedRoom, ghost: float) -> None:
    light = photograph_light(rig_in(changed(room, ghost=ghost)), 6, 4)
    assert ghost_of(light) == pytest.approx(ghost, abs=0.002)
    found = {row.name: row for row in light_rows(light)}["ghost"]
    assert found.state == (CheckState.POOR if ghost else CheckState.OK)


def test_ghosting_does_not_change_other_rows(room: SimulatedRoom) -> None:
    report = check_rig(rig_in(changed(room, ghost=0.3, exposure_us=PERIOD_US)), config(), QUIET)
    assert {row.name for row in report.rows if row.state != CheckState.OK} == {"ghost"}
    assert "nothing moved by more than noise" in row(report, "steadiness").finding.message
    assert row(report, "response").finding.message == "gamma 2.20"
    assert report.failure is None


def test_a_mirrored_picture_is_reported(room: SimulatedRoom) -> None:
    rig = rig_in(changed(room, panel={"mirrored": True}))
    quick = view.take_quick(rig, config(), FringeMeter(), QUIET)
    found, failure = view.view_row(quick, config(), [])
    assert found.state == CheckState.FAILED
    assert "the projector mirrors its picture" in found.finding.message
    assert "rear projection" in found.finding.advice
    assert failure is not None


@pytest.mark.parametrize(
    ("settings", "said", "least", "most"),
    [
        ({}, "", 0.98, 1.02),
        ({"projector_blur_px": 2.0, "camera_blur_px": 2.0}, "", 0.98, 1.02),
        ({"panel": {"keystone": 0.1}}, "keystone", 0.3, 0.65),
        ({"panel": {"squeeze": 0.75}}, "aspect", 0.3, 0.65),
        ({"sharpening": 0.5}, "sharpness", 1.4, 1.6),
    ],
)
def test_the_contrast_of_single_pixels_is_measured(
    room: SimulatedRoom, settings: dict[str, object], said: str, least: float, most: float
) -> None:
    rig = rig_in(changed(room, **settings))
    light = photograph_light(rig, 6, 4)
    ramp = measure_ramp(rig, light)
    assert ramp is not None
    found = pixel_row(rig, PixelGrid(), light, ramp)
    assert found is not None
    percent, *_ = re.findall(r"(\d+) %", found.finding.message)
    assert 100 * least < float(percent) < 100 * most
    assert said in found.finding.advice
    assert found.state == (CheckState.POOR if said else CheckState.OK)


@pytest.mark.parametrize(("device", "px"), [("projector", 0.0), ("projector", 0.3), ("camera", 0.3)])
def test_motion_during_the_check_is_reported(room: SimulatedRoom, device: str, px: float) -> None:
    rig = rig_in(room)
    quick = view.take_quick(rig, config(), FringeMeter(), QUIET)
    assert quick.decoding is not None
    light = photograph_light(rig, 3, 2)
    before = InitialState(time.monotonic(), light, levels_of(capture(rig, patterns()).frames))
    later = rig_in(changed(room, bump={"device": device, "px": px}))
    now = levels_of(capture(later, patterns()).frames)
    found = steadiness_row(later, before, now, view.projector_map(quick.decoding))
    assert found is not None
    assert found.state == (CheckState.POOR if px else CheckState.OK)
    moved = re.search(r"the (\w+) moved by ([0-9.]+) px", found.finding.message)
    assert (moved is not None) == (px > 0)
    if moved:
        assert moved[1] == device
        assert 0.8 * px < float(moved[2]) < 1.2 * px


def test_a_lamp_still_warming_up_is_reported() -> None:
    still = RigidFit(np.zeros(8), np.eye(8), 0.0)
    assert row_of(still, -0.2, 60).state == CheckState.OK
    assert "warm" in row_of(still, -0.8, 60).finding.advice


def test_flickering_lamps_are_distinguished_from_the_projector() -> None:
    rng = np.random.default_rng(0)
    shape = (40, 60)

    def frame(level: float, lamp: float) -> np.ndarray:
        return np.rint(rng.normal(level + lamp, 1.0, shape)).astype(np.uint8)

    lamp = iter([8, -9, 12, -10, 7, -8, 11, -9, 10, -12])
    light = Light(tuple(frame(180, next(lamp)) for _ in range(6)), tuple(frame(40, next(lamp)) for _ in range(4)), 255)
    (found,) = [row for row in light_rows(light) if row.name == "flicker"]
    assert found.state == CheckState.POOR
    assert "mains" in found.finding.advice


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.6])
def test_the_response_is_measured(room: SimulatedRoom, gamma: float) -> None:
    rig = rig_in(changed(room, gamma=gamma))
    ramp = measure_ramp(rig, photograph_light(rig, 2, 2))
    assert ramp.response.gamma == pytest.approx(gamma, abs=0.03)
    true = np.linspace(0, 1, 256) ** gamma
    assert 1e-6 < np.abs(ramp.response.of_levels - true).max() < 0.01
    assert response_row(ramp).state == CheckState.OK


def test_a_clipping_response_is_reported() -> None:
    levels = np.linspace(0, 1, 16)
    clipping = ramp_of(np.minimum(1, 1.3 * levels))
    assert clipping.response is None
    assert response_row(clipping).state == CheckState.POOR
    assert "above grey level 20" in response_row(clipping).finding.message
    assert response_row(ramp_of(levels**2.2)).finding.message == "gamma 2.20"
    assert "off a power law" in response_row(ramp_of((levels + levels**3) / 2)).finding.message


def test_the_predicted_sigma_matches_the_scan(room: SimulatedRoom, usual: CheckReport) -> None:
    whole = changed(room, exposure_us=PERIOD_US)
    (found,) = decode([capture(rig_in(whole), config().sequence.patterns(PROJECTOR))], QUIET, "")
    (solution,) = solve(label([found], [found], config()), config())
    truth = relative_focal_sigmas(solution.calibration)
    predicted = [float(word) / 100 for word in row(usual, "view").finding.message.split() if word[0].isdigit()]
    for sigma, device in zip(predicted, ("camera", "projector"), strict=True):
        assert 0.5 < sigma / truth[device] < 3.5  # said to two digits, from a few frames, and rather too large


@pytest.mark.parametrize(
    ("middle", "words"),
    [
        ((0.2, 0.0), "Turn the camera to the right, as seen"),
        ((-0.2, 0.01), "Turn the camera to the left, as seen"),
        ((0.0, 0.2), "Turn the camera down, as seen"),
        ((-0.1, -0.2), "Turn the camera to the left and up, as seen"),
        ((0.0, 0.0), "Move it."),
    ],
)
def test_directions_to_turn_the_camera(middle: tuple[float, float], words: str) -> None:
    assert view._turned("the camera", middle, "Move it").startswith(words)


def test_a_camera_that_looks_past_the_picture_gets_directions(usual: CheckReport) -> None:
    seen = np.zeros((18, 32), bool)
    seen[:, :8] = True
    coverage = view.PictureCoverage(0.01, (-0.4, 0.0), 0.25, (-0.375, 0.0), seen, 1.0)
    found = view.coverage_row(coverage, decoding_with(np.ones((4, 4), np.uint8)))
    assert found.state == CheckState.POOR
    assert "Turn the camera to the left" in found.finding.advice
    assert "Turn the projector to the left" in found.finding.advice


def test_undecoded_lit_pixels_give_no_directions() -> None:
    coverage = view.PictureCoverage(0.02, (-0.4, 0.0), 0.4, (0.0, 0.0), np.ones((18, 32), bool), 1.0)
    found = view.coverage_row(coverage, decoding_with(np.array([[0, 3, 3, 7]], np.uint8)))
    assert found.state == CheckState.POOR
    assert "only 25 % of the lit pixels decode" in found.finding.message
    assert "Turn" not in found.finding.advice


def test_without_a_match_nothing_is_covered() -> None:
    reasons = np.full((48, 64), 3, np.uint8)
    matches = Matches(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32))
    coverage = view.coverage_of(cast(Decoding, SimpleNamespace(reasons=reasons, matches=matches)), PROJECTOR)
    assert (coverage.camera, coverage.projector, coverage.span) == (0.0, 0.0, 0.0)
    assert coverage.camera_middle == coverage.projector_middle == (0.0, 0.0)


def decoding_with(reasons: NDArray[np.uint8]) -> Decoding:
    """The parts of a decoding that the row reads."""
    return cast(Decoding, SimpleNamespace(reasons=reasons))


class Blind:
    """A camera that always sees the same, until it fails."""

    size = (64, 48)
    highest_level = 255
    capabilities = Capabilities()

    def __init__(self, frames: int = 1000) -> None:
        self._left = frames
        self._rng = np.random.default_rng(0)

    def show(self, image: np.ndarray) -> None:
        pass

    def grab(self) -> Frame:
        self._left -= 1
        if self._left < 0:
            raise DeviceError("camera blind: it is gone. Check cable and power, then rerun.")
        return Frame(self._rng.normal(20, 1, (48, 64)).astype(np.uint8))


def test_a_camera_that_sees_no_light_fails_with_what_to_do() -> None:
    blind = Blind()
    report = check_rig(Rig(blind, blind), config(), QUIET)
    assert isinstance(report.failure, RefusalError)
    assert report.state == CheckState.FAILED
    assert "lens cap" in row(report, "coverage").finding.advice
    assert row(report, "exposure").state == CheckState.FAILED


def test_a_device_that_fails_ends_the_check_with_what_is_known() -> None:
    blind = Blind(frames=8)
    report = check_rig(Rig(blind, blind), config(), QUIET)
    assert isinstance(report.failure, DeviceError)
    assert [row.name for row in report.rows][:3] == ["camera", "projector", "latency"]
    assert "it is gone" in report.rows[-1].finding.message
    assert report.rows[-1].state == CheckState.FAILED


def test_everything_white_is_overexposed_not_dark() -> None:
    white = np.full((48, 64), 255, np.uint8)
    seen = exposure_levels(Light((white,) * 2, (white,) * 2, 255), 1000.0)
    assert seen.is_clipped
    assert not seen.is_dark


@pytest.mark.parametrize("light", [(0.0,), (0.0, 0.5), (0.1, 1.0), (0.0, 0.6, 0.6, 1.0)])
def test_a_response_that_does_not_rise_is_refused(light: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="rise from 0 to 1"):
        ProjectorResponse(light)
