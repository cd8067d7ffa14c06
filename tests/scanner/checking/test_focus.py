"""Which of two lenses is out of focus."""

from dataclasses import replace

import numpy as np
import pytest

from calib.numerics import Floats
from hw.simulated import SimulatedRoom
from scanner.checking.check import check_rig
from scanner.checking.focus import BlurSamples, amplitude_left, finest_period_px, focus_row, period_for, separate_lenses
from scanner.checking.report import CheckState
from scanner.patterns import sequence_for
from scanner.ui import Terminal
from tests.support.rig_bench import PERIOD_US, changed, config, rig_in, row

pytestmark = pytest.mark.xdist_group("checking")


@pytest.mark.parametrize(
    ("blur", "advice"),
    [
        ({"projector_blur_px": 2.2}, "Focus the projector."),
        ({"camera_blur_px": 2.2}, "Focus the camera."),
    ],
)
def test_the_defocused_lens_is_named(room: SimulatedRoom, blur: dict[str, float], advice: str) -> None:
    report = check_rig(rig_in(changed(room, exposure_us=PERIOD_US, **blur)), config(), Terminal(quiet=True))
    found = row(report, "focus")
    assert found.state == CheckState.POOR
    assert found.finding.advice.startswith(advice)


def samples_of(projector: float, camera: float, *, noise: float = 0.02, even: bool = False) -> BlurSamples:
    """Blurs in the pixels of either device, on three oblique faces or (`even`) on one that faces both."""
    rng = np.random.default_rng(5)
    where = rng.uniform(0, 1, (200, 2))
    span = np.full(200, 1.3) if even else 1.0 + 0.3 * (where[:, 0] > 0.5) + 0.3 * (rng.random(200) > 0.5)
    blur2 = projector**2 + camera**2 * span**2 + noise * rng.standard_normal(200)
    return BlurSamples(blur2, span, where, np.full(200, 0.01), 0.0)


@pytest.mark.parametrize(("projector", "camera"), [(0.5, 0.5), (2.0, 0.5), (0.5, 2.0), (0.0, 1.0), (1.5, 1.5)])
def test_blur_is_split_between_the_lenses(projector: float, camera: float) -> None:
    samples = samples_of(projector, camera)
    lenses = separate_lenses(samples)
    assert 1e-4 < lenses.projector2_sigma < 0.1
    assert abs(lenses.projector2 - projector**2) < 4 * lenses.projector2_sigma
    assert abs(lenses.camera2 - camera**2 * lenses.span**2) < 4 * lenses.camera2_sigma


def test_a_probably_defocused_lens_is_named_as_probable() -> None:
    samples = replace(samples_of(1.25, 0.5), doubt2=np.full(200, 0.2))
    found = focus_row(samples, separate_lenses(samples), 6.7)
    assert found.state == CheckState.POOR
    assert found.finding.advice.startswith("Focus the projector, which seems to be the one")


def test_undecidable_blur_is_not_attributed() -> None:
    samples = samples_of(1.5, 1.5, noise=0.05, even=True)
    found = focus_row(samples, separate_lenses(samples), 6.7)
    assert found.state == CheckState.POOR
    assert "does not show which lens" in found.finding.advice


@pytest.mark.parametrize(
    ("projector", "camera", "advice"),
    [(0.5, 0.5, ""), (2.0, 0.5, "Focus the projector."), (0.5, 2.0, "Focus the camera."), (2.5, 2.5, "Focus the proj")],
)
def test_advice(projector: float, camera: float, advice: str) -> None:
    samples = samples_of(projector, camera)
    found = focus_row(samples, separate_lenses(samples), 6.7)
    assert found.finding.advice.startswith(advice)
    assert (found.state == CheckState.OK) == (advice == "")


def test_a_coarse_camera_gets_no_focus_advice() -> None:
    samples = samples_of(0.3, 0.5)
    coarse = BlurSamples(0.3**2 + 0.5**2 * (4 * samples.span) ** 2, 4 * samples.span, *vars_of(samples))
    found = focus_row(coarse, separate_lenses(coarse), 6.7)
    assert found.state == CheckState.POOR
    assert "too coarse" in found.finding.advice


def vars_of(samples: BlurSamples) -> tuple[Floats, Floats, float]:
    return samples.where, samples.doubt2, samples.lost


def test_the_most_blurred_part_of_the_image_is_named() -> None:
    samples = samples_of(0.5, 0.5)
    tilted = samples.blur2 + 3.0 * ((samples.where[:, 0] > 0.6) & (samples.where[:, 1] > 0.6))
    found = focus_row(BlurSamples(tilted, samples.span, *vars_of(samples)), separate_lenses(samples), 6.7)
    assert "in the lower right part of the image" in found.finding.message


def test_stripes_blurred_away_everywhere_are_reported() -> None:
    none = np.zeros(0)
    found = focus_row(BlurSamples(none, none, np.zeros((0, 2)), none, 1.0), None, 6.7)
    assert found.state == CheckState.FAILED


def test_amplitude_and_periods() -> None:
    assert amplitude_left(0.0, 6.7) == 1
    assert amplitude_left(1.0, 2 * np.pi) == pytest.approx(np.exp(-0.5))
    assert finest_period_px(sequence_for((64, 48), cell=8, periods=(16.0, 6.7))) == 6.7
    assert finest_period_px(sequence_for((64, 48), cell=8, shifts=0)) == 16
    assert [period_for(span) for span in (0.5, 1.3, 2.0, 9.0)] == [4.3, 6.1, 8.6, 24.6]
