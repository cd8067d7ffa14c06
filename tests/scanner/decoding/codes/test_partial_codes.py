"""Pixels that lack some bits of a Gray code, and false codes in stray light."""

from dataclasses import replace

import numpy as np
import pytest

from scanner.decoding import MaskReason, plan_sequence
from scanner.decoding.codes import interval_of
from scanner.patterns import Black, White, gray_sequence, sequence_for
from tests.support.synthetic_capture import Scene, decode, dimmed

SCENE = Scene()
COARSE_CAMERA = replace(SCENE, projector=(440, 300))
GRAY = sequence_for(COARSE_CAMERA.projector, cell=1, shifts=0)


@pytest.mark.parametrize(
    "scene",
    [replace(COARSE_CAMERA, camera_blur_px=1.3), dimmed(COARSE_CAMERA, 0.15)],
    ids=["blurred", "dark"],
)
def test_a_camera_coarser_than_the_cells_matches_nearly_all_pixels(scene: Scene) -> None:
    decoding = scene.decode(GRAY)
    assert np.mean(decoding.reasons[scene.well_lit()] == MaskReason.KEPT) > 0.7
    errors = np.linalg.norm(scene.errors(decoding), axis=1)
    assert 0.04 < np.median(errors) < 0.2
    assert np.mean(errors < 3) > 0.98


def test_an_undecided_bit_leaves_both_cells_and_unresolved_fine_bits_their_block() -> None:
    plan = plan_sequence((*gray_sequence("x", 64, 1), *gray_sequence("y", 64, 1)), (64, 64))
    numbers = np.array([7, 8, 20, 20], np.uint8)
    words = (numbers ^ numbers >> 1).astype(np.uint8)
    # 7 and 8 differ in the fourth bit from the end, 20 and 21 in the last one; without two bits 20 … 23 are left.
    undecided = np.array([8, 8, 1, 3], np.uint32)
    interval = interval_of(plan.x, [words], 4, {0: undecided})
    np.testing.assert_array_equal(interval.low, [6.5, 6.5, 19.5, 19.5])
    np.testing.assert_array_equal(interval.high, [8.5, 8.5, 21.5, 23.5])


def test_false_codes_in_stray_light_are_masked() -> None:
    """Where no direct light falls, dim light comes from elsewhere in the picture."""
    scene = replace(SCENE, gamma=1.0)
    patterns = sequence_for(scene.projector, cell=1, shifts=0)
    stray = np.zeros(scene.camera[::-1], np.bool_)
    stray[:, -120:] = True
    rng = np.random.default_rng(4)
    scatter = rng.permutation(stray.sum())
    frames = []
    for frame in scene.frames(patterns):
        lit = frame.astype(np.float64)
        lit[stray] = 8 + 0.25 * (lit[:, :120].reshape(-1)[scatter] - 8)
        frames.append(np.rint(lit).astype(np.uint8))
    decoding = decode(patterns, frames, scene.projector)
    kept = decoding.reasons == MaskReason.KEPT
    assert np.mean(kept[stray]) < 0.02
    assert np.mean(kept[~stray & scene.well_lit()]) > 0.6


def test_without_black_the_threshold_comes_from_a_pair() -> None:
    scene = replace(SCENE, ambient=90.0, exposure=80.0)
    patterns = tuple(p for p in sequence_for(scene.projector) if not isinstance(p, White | Black))
    decoding = scene.decode(patterns)
    assert np.mean(decoding.reasons[scene.well_lit()] == MaskReason.KEPT) > 0.97
    assert 0.01 < np.median(np.abs(scene.errors(decoding))) < 0.08
