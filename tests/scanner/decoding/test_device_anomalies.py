"""Captures with anomalies due to devices or people are decoded with a warning; real errors are still refused."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from calib.numerics import Image
from scanner.decoding.mask_reasons import MaskReason
from scanner.patterns import Pattern, sequence_for
from tests.support.findings import kinds_of, the_only
from tests.support.synthetic_capture import Scene, decode, dimmed

SCENE = Scene(camera=(400, 300), projector=(400, 260))
# Ambient light is stronger than the projector's, so that a brighter frame changes by more than a bit does.
BRIGHT_ROOM = replace(SCENE, exposure=60.0, ambient=70.0, black_level=0.03)
STANDARD = sequence_for(SCENE.projector)
CODE = sequence_for(SCENE.projector, shifts=0, cell=1)
QUICK = sequence_for(SCENE.projector, inverses=False, periods=(12.3,))

Change = Callable[[list[Image]], Sequence[np.ndarray]]


def flickering(frames: list[Image]) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    return [frame * rng.uniform(0.85, 1.15) for frame in frames]


def banded(frames: list[Image]) -> list[np.ndarray]:
    rng, rows = np.random.default_rng(5), np.arange(len(frames[0]))[:, None]
    return [frame * (1 + 0.05 * np.sin(6 * np.pi * rows / len(rows) + rng.uniform(0, 6.3))) for frame in frames]


def lit_from_the_20th_on(frames: list[Image]) -> list[np.ndarray]:
    return [frame + (number >= 20) * 0.06 * frames[0] for number, frame in enumerate(frames)]


def the_10th_darker(frames: list[Image]) -> list[np.ndarray]:
    return [frame * (0.6 if number == 10 else 1.0) for number, frame in enumerate(frames)]


def a_step_darker(frames: list[Image]) -> list[np.ndarray]:
    return [*frames[:-2], 0.6 * frames[-2], frames[-1]]


def lit_from_the_last_step_on(frames: list[Image]) -> list[np.ndarray]:
    return [*frames[:-1], frames[-1] + 0.1 * frames[0]]


def lit_in_all_but_white(frames: list[Image]) -> list[np.ndarray]:
    return [frames[0], *(frame + 20.0 for frame in frames[1:])]


def passed_by(frames: list[Image]) -> list[np.ndarray]:
    result: list[np.ndarray] = list(frames)
    for number in range(6, 11):
        seen, at = frames[number].copy(), 30 + 12 * number
        seen[100:, at : at + 60] = 0.3 * seen[100:, at : at + 60] + 20
        result[number] = seen
    return result


def behind_filters(frames: list[Image]) -> list[np.ndarray]:
    rows, columns = np.indices(frames[0].shape) % 2
    return [frame * np.array([[0.5, 1.0], [1.0, 0.65]])[rows, columns] for frame in frames]


def sharpened(frames: list[Image]) -> list[np.ndarray]:
    return [2.0 * frame - cv2.GaussianBlur(frame.astype(np.float64), (0, 0), 1.5) for frame in frames]


@dataclass(frozen=True)
class Case:
    """`median`: what the error of a coordinate may be in px; `kept`: least share of the lit pixels."""

    scene: Scene
    patterns: tuple[Pattern, ...]
    change: Change
    median: float
    kept: float

    def __str__(self) -> str:
        room = "bright room" if self.scene.ambient > self.scene.exposure else "dark room"
        sequence = {STANDARD: "standard", QUICK: "quick", CODE: "code"}[self.patterns]
        return f"{self.change.__name__}, {room}, {sequence}"


CASES = [
    Case(SCENE, STANDARD, flickering, 0.03, 0.99),
    Case(BRIGHT_ROOM, STANDARD, flickering, 0.12, 0.99),
    Case(SCENE, CODE, flickering, 0.3, 0.6),
    Case(SCENE, STANDARD, banded, 0.035, 0.99),
    Case(SCENE, STANDARD, lit_from_the_20th_on, 0.03, 0.99),
    Case(BRIGHT_ROOM, STANDARD, the_10th_darker, 0.12, 0.99),
    Case(BRIGHT_ROOM, CODE, the_10th_darker, 0.3, 0.4),
    Case(BRIGHT_ROOM, QUICK, a_step_darker, 0.12, 0.99),
    Case(SCENE, STANDARD, lit_from_the_last_step_on, 0.1, 0.99),
    Case(SCENE, STANDARD, lit_in_all_but_white, 0.03, 0.99),
    Case(SCENE, STANDARD, passed_by, 0.03, 0.7),
    Case(SCENE, STANDARD, sharpened, 0.04, 0.99),
    Case(SCENE, QUICK, behind_filters, 0.06, 0.99),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_capture_with_an_anomaly_decodes(case: Case) -> None:
    frames = [np.rint(np.clip(f, 0, 255)).astype(np.uint8) for f in case.change(case.scene.frames(case.patterns))]
    decoding = decode(case.patterns, frames, case.scene.projector)
    errors = np.abs(case.scene.errors(decoding))
    assert 0.005 < np.median(errors) < case.median
    assert np.mean(errors.max(axis=1) > 3) < 0.02
    assert np.mean(decoding.reasons[case.scene.well_lit()] == MaskReason.KEPT) > case.kept
    if case.change in (flickering, banded, the_10th_darker, a_step_darker):
        assert "flicker" in kinds_of(decoding.findings)
    assert ("raw-colours" in kinds_of(decoding.findings)) == (case.change is behind_filters)
    if case.change is passed_by:
        assert 6 in the_only("frames-contradict", decoding.findings).numbers("frames")


# The last: lit in a fifth of the image only.
@pytest.mark.parametrize(("quality", "scene"), [(50, SCENE), (85, SCENE), (70, replace(SCENE, zoom=2.0))])
def test_lossy_compression_raises_the_sigma(quality: int, scene: Scene) -> None:
    frames = []
    for frame in scene.frames(QUICK):
        _, compressed = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])
        frames.append(np.asarray(cv2.imdecode(compressed, cv2.IMREAD_GRAYSCALE), np.uint8))
    decoding = decode(QUICK, frames, scene.projector)
    errors, sigma = scene.errors(decoding), decoding.matches.sigma_px
    assert sigma is not None
    # Pixels of a block err alike, so that a little of it passes for the surface's shape.
    assert 0.7 < np.std(np.clip(errors / sigma[:, None], -6, 6)) < 1.5
    # In the dark a block is as even as a surface, and its fringes those of rounding.
    assert np.mean(np.abs(errors) > 3) < 1e-3
    assert np.mean(decoding.reasons[scene.well_lit()] == MaskReason.KEPT) > 0.97


@pytest.mark.parametrize("scene", [replace(SCENE, projector_blur_px=2.5), replace(SCENE, camera_blur_px=3.0)])
def test_unresolved_bits_are_ignored(scene: Scene) -> None:
    decoding = scene.decode(CODE)
    unresolved = [finding for finding in decoding.findings if finding.kind.name == "unresolved-bits"]
    assert unresolved
    assert {finding.data["cell_px"] for finding in unresolved} == {2}
    assert 5_000 < len(decoding.matches) < 30_000, "a few hundred with all bits"
    assert decoding.matches.sigma_px is not None
    ratio = scene.errors(decoding) / decoding.matches.sigma_px[:, None]
    assert 0.2 < np.median(np.abs(ratio)) < 1.0, "evenly spread over cells of two, and averaged over their pixels"


@pytest.mark.parametrize("blur_px", [3.0, 4.0])
def test_a_lens_that_weakens_the_only_fringes_is_not_taken_for_stray_light(blur_px: float) -> None:
    scene = replace(SCENE, projector_blur_px=blur_px)
    decoding = scene.decode(QUICK)
    errors = np.abs(scene.errors(decoding))
    assert 0.03 < np.median(errors) < 0.25
    assert np.quantile(errors, 0.99) < 1.0
    assert np.mean(decoding.reasons[scene.well_lit()] == MaskReason.KEPT) > 0.9


def test_where_a_lens_weakens_the_only_fringes_faint_ones_count() -> None:
    # Of a fringe that five sigmas would be asked of, one pixel in a hundred.
    scene = dimmed(replace(SCENE, projector_blur_px=4.0), 0.6)
    decoding = scene.decode(QUICK)
    errors, sigma = scene.errors(decoding), decoding.matches.sigma_px
    assert sigma is not None
    assert 0.85 < np.mean(decoding.reasons[scene.well_lit()] == MaskReason.KEPT) < 0.99
    assert 0.15 < np.median(np.abs(errors)) < 0.4
    assert np.mean(np.abs(errors) > 3) < 1e-4, "in another cycle"
    assert 0.9 < np.std(np.clip(errors / sigma[:, None], -6, 6)) < 1.2


def test_where_the_only_fringes_are_blurred_away_the_code_is_decoded_alone() -> None:
    scene = replace(SCENE, projector_blur_px=6.0)
    decoding = scene.decode(QUICK)
    assert the_only("blurred-fringes", decoding.findings).data["cell_px"] == 8
    assert 500 < len(decoding.matches) < 1200, "one for each cell"
    assert decoding.matches.sigma_px is not None
    errors = np.abs(scene.errors(decoding))
    assert 0.03 < np.median(errors) < 0.2
    assert 0.2 < np.median(errors / decoding.matches.sigma_px[:, None]) < 1.0


@pytest.mark.parametrize(("steps", "gamma"), [(5, 1.0), (7, 2.2)])
def test_flicker_in_an_odd_number_of_steps_is_found_and_is_no_motion(steps: int, gamma: float) -> None:
    scene, patterns = replace(SCENE, gamma=gamma), sequence_for(SCENE.projector, shifts=steps)
    frames = [np.rint(np.clip(frame, 0, 255)).astype(np.uint8) for frame in flickering(scene.frames(patterns))]
    decoding = decode(patterns, frames, scene.projector)
    assert decoding.motion is not None
    assert not decoding.motion.is_significant
    # Evenly spread over ±15 %, which is 8.7 % as a standard deviation.
    assert decoding.flicker is not None
    assert 0.06 < decoding.flicker < 0.11
    assert 0.008 < np.median(np.abs(scene.errors(decoding))) < 0.018


def test_flicker_is_taken_out_where_the_picture_is_a_small_part_of_the_image() -> None:
    frames = [np.rint(frame).astype(np.uint8) for frame in flickering(SCENE.frames(STANDARD))]
    height, width = frames[0].shape
    decoding = decode(STANDARD, [np.pad(f, ((height, height), (width, 2 * width))) for f in frames], SCENE.projector)
    matches = replace(decoding.matches, camera_px=decoding.matches.camera_px - np.array([width, height]))
    errors = np.abs(SCENE.errors(replace(decoding, matches=matches)))
    assert 0.005 < np.median(errors) < 0.03
    assert len(matches) > 100_000
