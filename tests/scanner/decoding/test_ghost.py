"""A share of the picture before in every frame: found, and taken out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.numerics.array_types import Image
from scanner.decoding.decoder import Decoder
from scanner.patterns.pattern import Pattern, sequence_for
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


def filled(patterns: Sequence[Pattern], frames: Sequence[Image], ghost: float = 0.0) -> Decoder:
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
    assert share - 0.02 < found < share + 0.02
    decoder = filled(patterns, frames, found)
    assert decoder.ghost() == 0
    decoding = decoder.finish()
    limit = 0.4 if sequence == "gray" else 0.08
    assert 0.005 < np.median(np.abs(SCENE.errors(decoding))) < limit
    assert any(f"{found:.0%} of the picture before" in warning for warning in decoding.warnings)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_other_light_is_no_ghost(sequence: str) -> None:
    patterns = SEQUENCES[sequence]
    rng = np.random.default_rng(3)
    still = SCENE.frames(patterns)
    flickering = [np.rint(frame * rng.uniform(0.7, 0.95)).astype(np.uint8) for frame in still]
    switched = [frame if number < 9 else np.minimum(frame, 225) + np.uint8(30) for number, frame in enumerate(still)]
    for frames in (still, flickering, switched):
        assert filled(patterns, frames).ghost() == 0


def test_a_clipped_pixel_stays_masked() -> None:
    scene = replace(SCENE, exposure=330.0)
    patterns = SEQUENCES["standard"]
    frames = ghostly(scene.frames(patterns), 0.2)
    clipped = np.mean(np.maximum.reduce(frames) == 255)
    assert 0.05 < clipped < 0.9
    without = filled(patterns, frames, 0.2).finish()
    assert np.median(np.abs(scene.errors(without))) < 0.08
