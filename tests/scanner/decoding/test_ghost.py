"""A share of the picture before in every frame: found, and taken out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.numerics.array_types import Image
from scanner.decoding.decoder import Decoder
from scanner.decoding.light.ghost import Ghost
from scanner.patterns.pattern import Gray, Pattern, sequence_for
from scanner.patterns.presets import PRESETS
from tests.support.synthetic_capture import Scene, fringes

SCENE = Scene()
SEQUENCES = {
    "standard": sequence_for(SCENE.projector),
    "quick": PRESETS["quick"].patterns(SCENE.projector),
    "gray": sequence_for(SCENE.projector, cell=1, shifts=0),
    "fringes": fringes((310.0, 62.0, 16.0), 4),
}


def ghostly(frames: Sequence[Image], share: float, top: int = 255) -> list[Image]:
    """Frames that show some of the one before; before the first it was dark."""
    light = [frame.astype(np.float64) for frame in frames]
    dark = np.minimum.reduce(light)
    mixed = [(1 - share) * frame + share * before for frame, before in zip(light, [dark, *light[:-1]], strict=True)]
    return [np.rint(np.minimum(one, top)).astype(frames[0].dtype) for one in mixed]


def filled(patterns: Sequence[Pattern], frames: Sequence[Image], ghost: Ghost | None = None) -> Decoder:
    decoder = Decoder(patterns, SCENE.projector, ghost=ghost)
    for frame in frames:
        decoder.add(frame)
    return decoder


@pytest.mark.parametrize("share", [0.1, 0.3])
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_a_ghost_is_found_and_taken_out(sequence: str, share: float) -> None:
    patterns = SEQUENCES[sequence]
    frames = ghostly(SCENE.frames(patterns), share)
    found = filled(patterns, frames).ghost()
    assert found is not None
    assert found.place is None
    assert share - 0.02 < found.share < share + 0.02
    decoder = filled(patterns, frames, found)
    assert decoder.ghost() is None
    decoding = decoder.finish()
    limit = 0.4 if sequence == "gray" else 0.08
    assert 0.005 < np.median(np.abs(SCENE.errors(decoding))) < limit
    assert any(f"{found.share:.0%} of the picture before" in warning for warning in decoding.warnings)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_other_light_is_no_ghost(sequence: str) -> None:
    patterns = SEQUENCES[sequence]
    rng = np.random.default_rng(3)
    still = SCENE.frames(patterns)
    flickering = [np.rint(frame * rng.uniform(0.7, 0.95)).astype(np.uint8) for frame in still]
    switched = [frame if number < 9 else np.minimum(frame, 225) + np.uint8(30) for number, frame in enumerate(still)]
    for frames in (still, flickering, switched):
        assert filled(patterns, frames).ghost() is None


def test_a_clipped_pixel_stays_masked() -> None:
    scene = replace(SCENE, exposure=330.0)
    patterns = SEQUENCES["standard"]
    frames = ghostly(scene.frames(patterns), 0.2)
    clipped = np.mean(np.maximum.reduce(frames) == 255)
    assert 0.05 < clipped < 0.9
    without = filled(patterns, frames, Ghost(0.2)).finish()
    assert np.median(np.abs(scene.errors(without))) < 0.08


@pytest.mark.parametrize("share", [0.35, 0.5])
@pytest.mark.parametrize("sequence", ["quick", "gray", "standard"])
def test_a_single_late_frame_is_found_and_taken_out(sequence: str, share: float) -> None:
    """Each of the coarse bits in turn, as taken while the projector still showed the picture before."""
    patterns = SEQUENCES[sequence]
    frames = SCENE.frames(patterns)
    bits = [n for n, pattern in enumerate(patterns) if isinstance(pattern, Gray) and 2 <= pattern.bit <= 4]
    for place in bits[::2]:
        late = frames.copy()
        late[place] = np.rint((1 - share) * frames[place].astype(float) + share * frames[place - 1]).astype(np.uint8)
        found = filled(patterns, late).ghost()
        assert found is not None, place
        assert found.place == place
        assert share - 0.04 < found.share < share + 0.04
        decoding = filled(patterns, late, found).finish()
        errors = np.abs(SCENE.errors(decoding))
        assert np.mean(errors > 1.2) < 0.005
        assert 0.005 < np.median(errors) < (0.4 if sequence == "gray" else 0.08)
        assert any(f"Frame {place} (" in warning and f"{found.share:.0%}" in warning for warning in decoding.warnings)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_mistakes_are_no_late_frames(sequence: str) -> None:
    """Frames that were exchanged, repeated or inverted, or one that is brighter, are another's business."""
    patterns = SEQUENCES[sequence]
    still = SCENE.frames(patterns)
    for place in range(3, len(still), 5):
        for other in (place - 1, place - 2, len(still) - place // 2 - 1):
            exchanged, repeated = still.copy(), still.copy()
            exchanged[place], exchanged[other] = still[other], still[place]
            repeated[place] = still[other]
            inverted, darker = still.copy(), still.copy()
            inverted[place] = 255 - still[place]
            darker[place] = np.rint(0.6 * still[place]).astype(np.uint8)
            for frames in (exchanged, repeated, inverted, darker):
                assert filled(patterns, frames).ghost() is None
