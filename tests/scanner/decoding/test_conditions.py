"""One sequence under different light and with different cameras: the expected masks and warnings, and no others."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.numerics import Image
from scanner.decoding.mask_reasons import MaskReason
from scanner.errors import InputError
from scanner.patterns import PRESETS, PresetName, White, sequence_for
from tests.support.findings import kinds_of, the_only
from tests.support.synthetic_capture import Scene, decode, dimmed

SCENE = Scene()
STANDARD = sequence_for(SCENE.projector)


@dataclass(frozen=True)
class Case:
    """`median`: largest median error of a coordinate in px."""

    name: str
    scene: Scene
    median: tuple[float, float]

    def __str__(self) -> str:
        return self.name


CASES = [
    Case("linear projector", replace(SCENE, gamma=1.0), (0.01, 0.03)),
    Case("strong gamma", replace(SCENE, gamma=3.0), (0.01, 0.03)),
    Case("hardly any noise", replace(SCENE, read_noise=0.0, electrons_per_level=1e6), (0.001, 0.01)),
    Case("noisy camera", replace(SCENE, read_noise=6.0), (0.03, 0.12)),
    Case("a tenth of the light", dimmed(SCENE, 0.1), (0.08, 0.2)),
    Case("more indirect light than direct", replace(SCENE, indirect=2.0, exposure=80.0), (0.02, 0.1)),
    Case("bright room", replace(SCENE, ambient=100.0, exposure=120.0), (0.02, 0.06)),
    Case("blurred projector", replace(SCENE, projector_blur_px=3.0), (0.02, 0.1)),
    Case("camera on its side", replace(SCENE, turn_deg=80.0), (0.01, 0.03)),
    Case("camera upside down", replace(SCENE, turn_deg=-170.0), (0.01, 0.03)),
    Case("close up", replace(SCENE, zoom=0.2), (0.01, 0.03)),
    Case("far away", replace(SCENE, zoom=3.0), (0.01, 0.06)),
    Case("12 bits", replace(SCENE, depth_bits=12), (0.005, 0.03)),
    Case("16 bits, in colour", replace(SCENE, depth_bits=16, colour=True), (0.005, 0.03)),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_expected_masks_and_warnings(case: Case) -> None:
    decoding = case.scene.decode(STANDARD)
    errors = np.abs(case.scene.errors(decoding))
    assert case.median[0] < np.median(errors) < case.median[1]
    assert np.mean(decoding.reasons[case.scene.well_lit()] == MaskReason.KEPT) > 0.99
    assert not np.any(decoding.reasons == MaskReason.MOVED)
    assert {*kinds_of(decoding.findings)} <= {"faint-fringes"}
    assert not decoding.findings or case.name in ("far away", "blurred projector")


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("gamma", [1.0, 3.0])
def test_gamma_causes_no_ripple_in_any_preset(preset: PresetName, gamma: float) -> None:
    scene = replace(SCENE, gamma=gamma, read_noise=0.2, electrons_per_level=1000.0)
    decoding = scene.decode(PRESETS[preset].patterns(SCENE.projector))
    for errors, coordinate in zip(scene.errors(decoding).T, decoding.matches.projector_px.T, strict=True):
        for period in PRESETS[preset].periods:
            phase = 2 * np.pi * coordinate / period
            ripple = [2 * abs(np.mean(np.clip(errors, -0.5, 0.5) * np.exp(1j * k * phase))) for k in (1, 2, 3, 4, 8)]
            assert 1e-5 < max(ripple) < 0.02


def test_flicker_is_measured_and_reported() -> None:
    for preset in PRESETS:
        patterns = PRESETS[preset].patterns(SCENE.projector)
        frames = SCENE.frames(patterns)
        steady = decode(patterns, frames, SCENE.projector)
        # Few groups of frames determine it only within a factor of two, mostly.
        found = [decode(patterns, flickering(frames, seed), SCENE.projector) for seed in range(3)]
        assert steady.flicker is not None
        assert steady.flicker < 0.006
        assert 0.02 < np.median([each.flicker or 0 for each in found]) < 0.08
        warned = ["flicker" in kinds_of(each.findings) for each in found]
        assert sum(warned) >= 2


def flickering(frames: Sequence[Image], seed: int) -> list[Image]:
    """Vary the brightness of each frame with a standard deviation of 4 %."""
    rng = np.random.default_rng(seed)
    return [np.rint(np.clip(frame * rng.normal(1, 0.04), 0, 255)).astype(np.uint8) for frame in frames]


@pytest.mark.parametrize("gamma", [1.8, 3.0])
def test_three_shifts_are_linearised_without_knowing_the_gamma(gamma: float) -> None:
    scene = replace(SCENE, gamma=gamma, read_noise=0.2, electrons_per_level=1000.0)
    decoding = scene.decode(sequence_for(SCENE.projector, periods=(16.0,), shifts=3))
    errors = scene.errors(decoding)[:, 0]
    phase = 2 * np.pi * decoding.matches.projector_px[:, 0] / 16
    ripple = 2 * abs(np.mean(np.clip(errors, -0.5, 0.5) * np.exp(3j * phase)))
    assert 1e-4 < ripple < 0.03, "0.5 to 1.0 px as it is measured"


def test_the_shadow_is_dark_and_the_edges_are_isolated() -> None:
    decoding = SCENE.decode(STANDARD)
    v, u = np.mgrid[: SCENE.camera[1], : SCENE.camera[0]].astype(np.float32)
    deep = np.all([SCENE.is_shadow(u + du, v + dv) for du in (-4, 0, 4) for dv in (-4, 0, 4)], axis=0)
    assert np.mean(decoding.reasons[deep] == MaskReason.DARK) > 0.99
    isolated = decoding.reasons == MaskReason.ISOLATED
    assert 0.005 < np.mean(isolated) < 0.02
    assert not np.any(isolated & SCENE.well_lit())


def test_saturated_pixels_are_masked_and_the_rest_stays_right() -> None:
    scene = replace(SCENE, exposure=330.0)
    decoding = scene.decode(STANDARD)
    saturated = decoding.reasons == MaskReason.SATURATED
    assert 0.4 < np.mean(saturated) < 0.95
    assert np.all(decoding.texture[saturated] >= 250)
    assert np.quantile(np.abs(scene.errors(decoding)).max(axis=1), 0.99) < 0.5
    assert "saturated" in kinds_of(decoding.findings)


@pytest.mark.parametrize("bits", [10, 16])
def test_saturation_is_found_at_any_bit_depth(bits: int) -> None:
    decoding = replace(SCENE, exposure=330.0, depth_bits=bits).decode(STANDARD)
    assert 0.4 < np.mean(decoding.reasons == MaskReason.SATURATED) < 0.95


def test_dark_pixels_are_masked_not_guessed() -> None:
    scene = dimmed(SCENE, 0.05)
    decoding = scene.decode(STANDARD)
    errors = np.abs(scene.errors(decoding)).max(axis=1)
    assert np.mean(decoding.reasons == MaskReason.DARK) > 0.3
    assert len(errors) > 0
    assert np.quantile(errors, 0.999) < 2.0


def test_the_texture_is_the_white_frame_in_its_own_colours() -> None:
    scene = replace(SCENE, colour=True)
    frames = scene.frames(STANDARD)
    texture = decode(STANDARD, frames, scene.projector).texture
    assert texture.shape == (*scene.camera[::-1], 3)
    assert np.array_equal(texture, frames[STANDARD.index(White())])


def test_without_white_the_texture_is_the_brightest_of_all_frames() -> None:
    frames = SCENE.frames(STANDARD)
    decoding = decode(STANDARD[1:], frames[1:], SCENE.projector)
    assert np.array_equal(decoding.texture, np.max(frames[1:], axis=0))
    difference = decoding.texture.astype(float) - frames[0]
    assert 0.01 < np.median(difference[SCENE.well_lit()]) < 10


def test_the_noise_is_measured() -> None:
    for patterns in (STANDARD, sequence_for(SCENE.projector, inverses=False)[2:]):
        noise = SCENE.decode(patterns).noise
        for level in (20, 80):
            true = np.sqrt(level / SCENE.electrons_per_level + SCENE.read_noise**2 + 1 / 12)
            assert 0.75 < noise.sigma(np.array(level)) / true < 1.5


def test_frames_are_not_modified() -> None:
    frames = SCENE.frames(STANDARD)
    before = [frame.copy() for frame in frames]
    whole = decode(STANDARD, frames, SCENE.projector)
    assert all(np.array_equal(*pair) for pair in zip(frames, before, strict=True))

    buffer = np.empty_like(frames[0])

    def grabbed() -> Iterator[Image]:
        for frame in frames:
            buffer[...] = frame
            yield buffer

    again = decode(STANDARD, grabbed(), SCENE.projector)
    assert np.array_equal(whole.matches.projector_px, again.matches.projector_px)


def test_dark_frames_are_reported_as_dark() -> None:
    """At a sixteenth of the light a few grey levels are left, which is the reason to report for any later failure."""
    assert "too-dark" not in kinds_of(SCENE.decode(STANDARD).findings)
    dark = the_only("too-dark", replace(SCENE, exposure=SCENE.exposure / 16).decode(STANDARD).findings)
    assert 0 < dark.number("noise_ratio") < 15
    assert 1 < dark.number("swing_grey_levels") < 20


@pytest.mark.parametrize("share", [0.01, 0.0])
@pytest.mark.parametrize("preset", PRESETS)
def test_hardly_any_light_causes_no_crash(preset: PresetName, share: float) -> None:
    """Frames that are identical to the last level must not cause a division by zero."""
    scene = replace(SCENE, exposure=share * SCENE.exposure, ambient=0.0, read_noise=0.2)
    with pytest.raises(InputError, match=r"no pixel changes clearly .* is the projector on"):
        scene.decode(PRESETS[preset].patterns(SCENE.projector))


@pytest.mark.parametrize(("preset", "seed"), [*((preset, 11) for preset in PRESETS), ("quick", 12)])
def test_individually_exposed_frames_are_not_taken_for_exchanged_ones(preset: PresetName, seed: int) -> None:
    """White is exposed from a third up to fully, the pattern frames at random: none may be taken for an exchanged
    frame, nor for whole periods of motion along one axis alone.
    """
    patterns = PRESETS[preset].patterns(SCENE.projector)
    frames = SCENE.frames(patterns)
    rng = np.random.default_rng(seed)
    for white in (1 / 3, 0.5, 1.0):
        factors = [white, 1.0, *rng.uniform(0.4, 1.0, len(frames) - 2)]
        exposed = [np.rint(frame * by).astype(np.uint8) for frame, by in zip(frames, factors, strict=True)]
        errors = np.abs(SCENE.errors(decode(patterns, exposed, SCENE.projector)))
        assert np.mean(errors > 1) < 0.002
        assert 0.005 < np.median(errors) < 0.12


@pytest.mark.parametrize(("preset", "periods"), [("concave", 2), ("quick", 1)])
def test_digitally_shifted_frames_have_larger_sigmas(preset: PresetName, periods: int) -> None:
    """Interpolation shifts short fringes less than long ones; with one period this goes unnoticed."""
    scene = replace(SCENE, read_noise=0.2, electrons_per_level=1000.0, zoom=1.6)
    patterns = PRESETS[preset].patterns(SCENE.projector)
    frames = scene.frames(patterns)
    moved = [np.rint(0.75 * frame + 0.25 * np.roll(frame, 1, axis=1)).astype(np.uint8) for frame in frames]
    still, shifted = (decode(patterns, one, SCENE.projector).smooth_px for one in (frames, moved))
    assert 1e-4 < still < 2e-3
    assert (3 * still < shifted < 0.05) if periods > 1 else shifted == still
