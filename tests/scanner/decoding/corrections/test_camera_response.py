"""Estimate a camera's tone curve from the sums of blurred and sharp stripes, and linearise its frames."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
import pytest

from calib.numerics import Floats, Image
from scanner.decoding import Decoding
from scanner.decoding.corrections.camera_response import CameraResponse
from scanner.patterns import Pattern, sequence_for
from tests.support.findings import kinds_of, the_only
from tests.support.synthetic_capture import Scene, corrections_to, decode

pytestmark = pytest.mark.xdist_group("camera response")  # frames are rendered once

SCENE = replace(Scene(), depth_bits=16, camera_blur_px=1.0, ambient=12.0)
BRIGHT_WALLS = replace(SCENE, indirect=0.5, exposure=150.0)
GRAY = sequence_for(SCENE.projector, code="gray", cell=1, inverses=True, shifts=0)
ALONE = sequence_for(SCENE.projector, code="gray", cell=1, inverses=False, shifts=0)
QUICK = sequence_for(SCENE.projector, code="gray", cell=8, inverses=False, periods=(12.3,), shifts=4)
FRINGES = sequence_for(SCENE.projector, code="gray", cell=8, inverses=True, shifts=4)
Curve = Callable[[Floats], Floats]


def linear(light: Floats) -> Floats:
    return light


def srgb(light: Floats) -> Floats:
    """The sRGB transfer function, IEC 61966-2-1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-6) ** (1 / 2.4) - 0.055)


def steep(light: Floats) -> Floats:
    level = srgb(light)
    return level**2 * (3 - 2 * level)


@lru_cache
def frames_of(patterns: tuple[Pattern, ...], scene: Scene) -> tuple[Image, ...]:
    return (*scene.frames(patterns),)


def photographs(patterns: Sequence[Pattern], curve: Curve, scene: Scene = SCENE) -> list[Image]:
    """Apply a tone curve to frames, and save them as JPEG."""
    digits = np.rint(255 * curve(np.linspace(0, 1, 2**16))).astype(np.uint8)
    saved = [
        cv2.imencode(".jpg", digits[frame], [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
        for frame in frames_of((*patterns,), scene)
    ]
    return [np.asarray(cv2.imdecode(file, cv2.IMREAD_GRAYSCALE), np.uint8) for file in saved]


def response_of(patterns: Sequence[Pattern], frames: Sequence[Image]) -> CameraResponse | None:
    return corrections_to(patterns, frames, SCENE.projector).response


def share_kept(decoding: Decoding) -> float:
    return float(np.mean(decoding.reasons[SCENE.well_lit()] == 0))


@pytest.mark.parametrize("curve", [srgb, steep])
@pytest.mark.parametrize(("patterns", "most_off"), [(GRAY, 0.012), (FRINGES, 0.035), (ALONE, 0.06)])
def test_the_curve_is_found(patterns: Sequence[Pattern], curve: Curve, most_off: float) -> None:
    found = response_of(patterns, photographs(patterns, curve))
    assert found is not None
    assert 0.0002 < off_by(found.light, curve) < most_off


def off_by(found: Floats, curve: Curve) -> float:
    """Return the largest error of a response (levels,), relative to white."""
    light = np.linspace(0, 1, 1001)
    true = np.interp(np.linspace(0, 1, len(found)), curve(light), light)
    used = slice(3, -3)  # of levels that are in the frames; light is known but for its unit and its zero
    fit = np.polyfit(true[used], found[used], 1)
    return float(np.abs(np.polyval(fit, true[used]) - found[used]).max() / fit[0])


@pytest.mark.parametrize(("curve", "most_off"), [(srgb, 0.05), (steep, 0.045)])
def test_indirect_light_shows_the_curve_where_stripes_are_wide_and_without_inverses(
    curve: Curve, most_off: float
) -> None:
    found = response_of(QUICK, photographs(QUICK, curve, BRIGHT_WALLS))
    assert found is not None
    assert 0.01 < off_by(found.light, curve) < most_off


@pytest.mark.parametrize("white", [1.0, 0.93, 0.9, 0.8])
def test_a_dark_white_frame_is_no_curve(white: float) -> None:
    frames = photographs(QUICK, linear, BRIGHT_WALLS)
    dimmed = [np.rint(white * frames[0]).astype(np.uint8), *frames[1:]]
    assert response_of(QUICK, dimmed) is None


@pytest.mark.parametrize("patterns", [GRAY, FRINGES, ALONE])
def test_a_linear_camera_has_no_curve(patterns: Sequence[Pattern]) -> None:
    assert response_of(patterns, photographs(patterns, linear)) is None


@pytest.mark.parametrize("blur_px", [2.0, 2.4])
def test_stripes_that_a_linear_camera_blurs_show_no_curve(blur_px: float) -> None:
    """Of a pixel's four finest bits one is seen and three are half-way, so that brightest and darkest do not add up."""
    scene = Scene(projector=(600, 400), camera_blur_px=blur_px, projector_blur_px=0.0, indirect=0.05)
    patterns = sequence_for(scene.projector, cell=1, inverses=False, shifts=0)
    assert corrections_to(patterns, scene.frames(patterns), scene.projector).response is None


def test_other_causes_of_unequal_sums_give_no_curve() -> None:
    frames = photographs(GRAY, linear)
    lamp = [np.minimum(frame + (0.2 * frames[0] if k > 11 else 0), 255) for k, frame in enumerate(frames)]
    flicker = 1 + 0.1 * np.random.default_rng(3).standard_normal(len(frames))
    ghost = [frames[0], *(0.75 * frame + 0.25 * before for before, frame in pairwise(frames))]
    for odd in (lamp, [f * by for f, by in zip(frames, flicker, strict=True)], ghost):
        assert response_of(GRAY, [np.rint(np.clip(frame, 0, 255)).astype(np.uint8) for frame in odd]) is None


@pytest.mark.parametrize("curve", [srgb, steep])
@pytest.mark.parametrize("patterns", [GRAY, ALONE])
def test_blur_under_a_tone_curve_is_neither_motion_nor_light(patterns: Sequence[Pattern], curve: Curve) -> None:
    decoding = decode(patterns, photographs(patterns, curve), SCENE.projector)
    assert share_kept(decoding) > 0.97
    assert 0.005 < np.median(np.abs(SCENE.errors(decoding))) < 0.05
    assert not {"moving-object", "light-switched", "flicker"} & {*kinds_of(decoding.findings)}
    assert 0.3 < decoding.noise.sigma(np.array([100.0]))[0] < 4, "grey levels of the frames as they were taken"


@pytest.mark.parametrize("curve", [srgb, steep])
def test_an_ambient_light_change_is_still_found(curve: Curve) -> None:
    light = replace(SCENE, ambient=SCENE.ambient + 25)
    before, after = (photographs(GRAY, curve, scene) for scene in (SCENE, light))
    decoding = decode(GRAY, [*before[:14], *after[14:]], SCENE.projector)
    assert the_only("light-switched", decoding.findings).numbers("frames") == (14,)
    assert share_kept(decoding) > 0.97


@pytest.mark.parametrize("curve", [linear, srgb, steep])
@pytest.mark.parametrize("more", [10, 25, 60])
def test_light_that_changes_within_a_pair_hides_no_curve(curve: Curve, more: int) -> None:
    """A pattern and its inverse, of which one has the added light, add up to neither of the usual sums."""
    light = replace(SCENE, ambient=SCENE.ambient + more)
    before, after = (photographs(GRAY, curve, scene) for scene in (SCENE, light))
    found = response_of(GRAY, [*before[:21], *after[21:]])
    assert (found is None) == (curve is linear)
    assert found is None or 0.0002 < off_by(found.light, curve) < 0.025


@pytest.mark.parametrize("curve", [srgb, steep])
def test_moving_objects_are_still_found(curve: Curve) -> None:
    """A dark object covers part of the picture in some frames."""
    frames = photographs(GRAY, curve)
    for frame in frames[12:16]:
        frame[40:110, 60:110] = 70
    decoding = decode(GRAY, frames, SCENE.projector)
    assert "moving-object" in kinds_of(decoding.findings)
    assert np.mean(decoding.reasons[50:100, 70:100] == 0) < 0.2


def test_frames_brighter_than_white_are_clipped_to_white() -> None:
    response = CameraResponse(np.array([0.0, 0.25, 1.0]), top=100.0, saturation=np.inf)
    frame = np.array([[0, 25, 50], [75, 100, 130]], np.uint16)
    assert response.light_of(frame).tolist() == [[0, 128, 256], [639, 1023, 1023]]


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_a_brightened_wall_beside_the_picture_is_no_blur(share: float) -> None:
    """By the light that other surfaces send there, all its fine bits are on the bright side of their thresholds."""
    scene = replace(SCENE, zoom=1.6)
    white, black, *bits = [frame.astype(np.float64) for frame in scene.frames(QUICK)]
    beside = white < white.max() / 10
    assert 0.6 < np.mean(beside) < 0.75, "most of what is lit"
    lit = beside * share * white.max() / np.mean(white - black)
    frames = [frame + lit * np.mean(frame - black) for frame in (white, black, *bits)]
    digits = np.rint(255 * srgb(np.linspace(0, 1, 2**16))).astype(np.uint8)
    decoding = decode(QUICK, [digits[frame.astype(np.uint16)] for frame in frames], scene.projector)
    assert 17_000 < len(decoding.matches) < 20_000
    assert 0.03 < np.median(np.abs(scene.errors(decoding))) < 0.1
    assert decoding.findings == ()
