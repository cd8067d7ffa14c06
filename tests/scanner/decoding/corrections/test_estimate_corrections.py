"""Corrections are estimated, and alternatives compared, on a sample before anything is decoded."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.numerics import Image
from scanner.patterns import PRESETS, Pattern, sequence_for
from tests.support.synthetic_capture import Scene, corrections_to

SCENE = replace(Scene(), exposure=150.0)
QUICK = PRESETS["quick"].patterns(SCENE.projector)
GRAY = sequence_for(SCENE.projector, code="gray", cell=1, inverses=True, shifts=0)


def lit_from(frames: Sequence[Image], number: int, share: float) -> list[Image]:
    """Add a lamp, of a share of white, from a frame on."""
    lamp = share * frames[0].astype(np.float64)
    return [np.rint(np.minimum(frame + (k >= number) * lamp, 255)).astype(np.uint8) for k, frame in enumerate(frames)]


@pytest.mark.parametrize("patterns", [QUICK, GRAY])
def test_steady_frames_need_no_correction(patterns: Sequence[Pattern]) -> None:
    found = corrections_to(patterns, SCENE.frames(patterns), SCENE.projector)
    assert (found.response, found.ghost, found.switch) == (None, None, None)


@pytest.mark.parametrize(("patterns", "number"), [(QUICK, 9), (GRAY, 14)])
def test_a_lamp_is_a_change_of_light_and_a_weak_one_is_not_corrected(patterns: Sequence[Pattern], number: int) -> None:
    frames = SCENE.frames(patterns)
    found = corrections_to(patterns, lit_from(frames, number, 0.3), SCENE.projector).switch
    assert found is not None
    assert found.frame == number
    assert 0.1 < found.share < 0.8
    assert corrections_to(patterns, lit_from(frames, number, 0.01), SCENE.projector).switch is None


def test_exchanged_frames_are_no_change_of_light() -> None:
    """The change that would explain them best leaves frames that fail the checks."""
    frames = SCENE.frames(QUICK)
    frames[4], frames[12] = frames[12], frames[4]
    assert corrections_to(QUICK, frames, SCENE.projector).switch is None


@pytest.mark.parametrize("seed", range(3))
def test_frames_of_random_exposure_are_no_change_of_light(seed: int) -> None:
    factors = np.random.default_rng(seed).uniform(0.5, 1.0, len(QUICK))
    frames = [np.rint(by * frame).astype(np.uint8) for by, frame in zip(factors, SCENE.frames(QUICK), strict=True)]
    assert corrections_to(QUICK, frames, SCENE.projector).switch is None


def test_random_exposures_of_white_and_black_are_no_change_of_light() -> None:
    """The gains of these two, which no other frame tells, explain as much as a lamp switched off after them."""
    scene = Scene()
    patterns = PRESETS["standard"].patterns(scene.projector)
    factors = [1.0, 1.0, *np.random.default_rng(3).uniform(0.4, 1.0, len(patterns) - 2)]
    frames = [np.rint(by * frame).astype(np.uint8) for by, frame in zip(factors, scene.frames(patterns), strict=True)]
    assert corrections_to(patterns, frames, scene.projector).switch is None
