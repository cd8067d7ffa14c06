"""Several exposures of each pattern, the level at which a camera saturates, and samples of its images."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import Capabilities, Frame, Rig
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.capture import capture, open_capture, record
from scanner.decoding import Decoder, Decoding, MaskReason, saturation_level
from scanner.decoding.light.samples import GridSample
from scanner.errors import InputError
from scanner.patterns import Black, Pattern, White, sequence_for
from tests.support.synthetic_capture import Scene

PATTERNS = sequence_for((300, 200), inverses=False)


def exposed(scene: Scene, factor: float) -> Scene:
    return replace(scene, exposure=factor * scene.exposure, ambient=factor * scene.ambient, seed=round(7 * factor))


def bracketed(scene: Scene, factors: Sequence[float]) -> list[tuple[Image, float]]:
    of_factors = [exposed(scene, factor).frames(PATTERNS) for factor in factors]
    return [
        (image, 1000 * factor)
        for images in zip(*of_factors, strict=True)
        for image, factor in zip(images, factors, strict=True)
    ]


def decoded(frames: Sequence[tuple[Image, float | None]], patterns: Sequence[Pattern]) -> Decoding:
    decoder = Decoder(patterns, (300, 200))
    for image, exposure_us in frames:
        decoder.add(image, exposure_us)
    return decoder.finish()


def twice(patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
    return tuple(pattern for pattern in patterns for _ in range(2))


@pytest.mark.parametrize(("bits", "colour"), [(8, True), (12, False)])
def test_two_exposures_cover_pixels_that_neither_covers_alone(bits: int, colour: bool) -> None:
    scene = Scene(box_brightness=8.0, indirect=0.02, read_noise=2.0, depth_bits=bits, colour=colour)
    short, long = exposed(scene, 0.1), exposed(scene, 1.0)
    lit = scene.well_lit()
    kept = [np.mean(s.decode(PATTERNS).reasons[lit] == MaskReason.KEPT) for s in (short, long)]
    merged = decoded(bracketed(scene, (0.1, 1.0)), twice(PATTERNS))
    assert kept[0] < 0.9, "the short one is noisy"
    assert kept[1] < 0.95, "the long one is saturated"
    assert np.mean(merged.reasons[lit] == MaskReason.KEPT) > 0.98 > max(kept)
    error = np.abs(scene.errors(merged))
    assert 0.005 < np.median(error) < 0.15
    assert merged.matches.sigma_px is not None
    assert 0.7 < np.std(np.clip(scene.errors(merged) / merged.matches.sigma_px[:, None], -6, 6)) < 1.35


def test_the_texture_is_from_the_shortest_exposure() -> None:
    scene = Scene()
    frames = bracketed(scene, (0.5, 2.0))
    merged = decoded(frames, twice(PATTERNS))
    difference = merged.texture.astype(float) - frames[0][0]
    assert np.abs(np.median(difference)) < 1
    assert 0.01 < np.std(difference) < 4


def test_exposures_may_be_in_any_order() -> None:
    scene = Scene()
    up, down = (decoded(bracketed(scene, factors), twice(PATTERNS)) for factors in ((0.4, 2.0), (2.0, 0.4)))
    assert np.array_equal(up.matches.projector_px, down.matches.projector_px)


@pytest.mark.parametrize(
    ("exposures_us", "said"),
    [
        ((None, None), "not their exposure_us"),
        ((500.0, 500.0), "exposures do not: 500 and 500"),
        ((500.0, 2000.0, 400.0, 2000.0), "first pattern"),
    ],
)
def test_exposures_that_do_not_fit_are_refused(exposures_us: tuple[float | None, ...], said: str) -> None:
    images = [image for image, _ in bracketed(Scene(), (0.5, 2.0))][:4]
    with pytest.raises(InputError, match=said):
        decoded(list(zip(images, exposures_us * 2, strict=False)), twice(PATTERNS))


def test_white_must_come_first() -> None:
    frames = bracketed(Scene(), (0.5, 2.0))
    with pytest.raises(InputError, match="white"):
        decoded([*frames[2:4], *frames[:2], *frames[4:]], twice((Black(), White(), *PATTERNS[2:])))


def test_all_patterns_have_one_exposure_if_the_first_has() -> None:
    frames = [(image, 500.0) for image in Scene().frames(PATTERNS)]
    with pytest.raises(InputError, match=r"frame 2 .*expected one exposure.*500 and 600"):
        decoded([frames[0], frames[0], frames[1], (frames[1][0], 600.0)], twice(PATTERNS))


@pytest.mark.parametrize("exposure_us", [None, 2000.0])
def test_frames_of_equal_exposure_are_averaged(exposure_us: float | None) -> None:
    scene = replace(Scene(read_noise=4.0), exposure=60.0)
    again = replace(scene, seed=2)
    order = [1, 0, *range(2, len(PATTERNS))]
    frames = [(images[at], exposure_us) for at in order for images in (scene.frames(PATTERNS), again.frames(PATTERNS))]
    averaged = decoded(frames, twice([PATTERNS[at] for at in order]))
    once = scene.decode(PATTERNS)
    ratio = np.median(np.abs(scene.errors(averaged))) / np.median(np.abs(scene.errors(once)))
    assert 0.6 < ratio < 0.85
    assert averaged.matches.sigma_px is not None
    assert 0.8 < np.std(np.clip(scene.errors(averaged) / averaged.matches.sigma_px[:, None], -6, 6)) < 1.3


def test_a_missing_frame_is_counted() -> None:
    frames = bracketed(Scene(), (0.5, 2.0))
    with pytest.raises(
        InputError, match=rf"has {len(frames)} frames, found {len(frames) - 2}.*frame {len(frames) - 2} "
    ):
        decoded(frames[:-1], twice(PATTERNS))


@pytest.mark.xdist_group("decode-simulation")
def test_a_simulated_capture_is_recorded_and_replayed(tmp_path: Path) -> None:
    settings = SimulatedRigSettings(seed=0, furniture=False, interreflection=False)
    room = SimulatedRoom(settings, (306, 256), (214, 120))
    projector = SimulatedProjector(room)
    rig = Rig(projector, SimulatedCamera(room, projector))
    exposure_us = room.sensor.exposure_us
    live = record(capture(rig, sequence_for((214, 120)), (0.2 * exposure_us, 2 * exposure_us)), tmp_path / "capture")
    seen = [(pattern, frame) for pattern, frame in live.frames]
    assert [round(frame.exposure_us / exposure_us, 6) for _, frame in seen[:2] if frame.exposure_us] == [0.2, 2.0]
    replayed = open_capture(tmp_path / "capture").stream()
    assert replayed.patterns == live.patterns
    decoder = Decoder(replayed.patterns, replayed.projector_size)
    for _, frame in replayed.frames:
        decoder.add(frame.image, frame.exposure_us)
    truth = room.ground_truth().projector_px
    matches = decoder.finish().matches
    x, y = np.rint(matches.camera_px).astype(int).T
    error = np.linalg.norm(matches.projector_px - truth[y, x], axis=1)
    assert 0.005 < np.nanmedian(error) < 0.1
    assert np.mean(np.isfinite(error)) > 0.99


def test_a_camera_of_one_exposure_is_refused() -> None:
    class Fixed:
        size = (8, 8)
        highest_level = 255
        capabilities = Capabilities()

        def grab(self) -> Frame:
            raise NotImplementedError

    room = SimulatedRoom(SimulatedRigSettings(furniture=False, interreflection=False), (64, 48), (64, 48))
    with pytest.raises(DeviceError, match="take every pattern with one exposure"):
        capture(Rig(SimulatedProjector(room), Fixed()), sequence_for((64, 48)), (1000.0, 2000.0))


@pytest.mark.parametrize(
    ("peak", "level"),
    [(1023, 1023), (4095, 4095), (65535, 65535), (65520, 65520), (4000, np.inf), (900, np.inf)],
)
def test_the_saturation_of_16_bit_images(peak: int, level: float) -> None:
    assert saturation_level(np.array([[3, peak]], np.uint16)) == level


def test_the_saturation_of_8_bit_images() -> None:
    assert saturation_level(np.array([[3, 9]], np.uint8)) == 254


@pytest.mark.parametrize("shape", [(225, 300), (7, 5), (1000, 1501), (224, 449)])
def test_a_grid_mask_is_enlarged_to_the_pixels_it_was_taken_from(shape: tuple[int, int]) -> None:
    grid = GridSample(shape)
    row, column = np.mgrid[: shape[0], : shape[1]]
    chosen = np.asarray(grid.of(column), np.float64) > shape[1] / 2
    assert np.array_equal(grid.of(grid.at_full_size(chosen)), chosen)
    beside = np.abs(column - shape[1] / 2) > grid.step
    assert np.array_equal(grid.at_full_size(chosen)[beside], (column > shape[1] / 2)[beside])
    assert np.array_equal(grid.rows, grid.of(row))
