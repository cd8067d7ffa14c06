"""Ghosting of the previous picture is detected and corrected."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.numerics import Image
from scanner.decoding import FrameCorrections, plan_sequence
from scanner.decoding.corrections import CorrectedFrames
from scanner.decoding.corrections.ghost import Ghost
from scanner.patterns import PRESETS, Gray, Pattern, sequence_for
from tests.support.findings import the_only
from tests.support.synthetic_capture import Scene, corrections_to, decode, fringes

SCENE = Scene()
SEQUENCES = {
    "standard": sequence_for(SCENE.projector),
    "quick": PRESETS["quick"].patterns(SCENE.projector),
    "gray": sequence_for(SCENE.projector, cell=1, shifts=0),
    "fringes": fringes((310.0, 62.0, 16.0), 4),
}


def ghostly(frames: Sequence[Image], share: float, top: int = 255) -> list[Image]:
    """Add a share of the previous frame to each frame; dark before the first one."""
    light = [frame.astype(np.float64) for frame in frames]
    dark = np.minimum.reduce(light)
    mixed = [(1 - share) * frame + share * before for frame, before in zip(light, [dark, *light[:-1]], strict=True)]
    return [np.rint(np.minimum(one, top)).astype(frames[0].dtype) for one in mixed]


def ghost_of(patterns: Sequence[Pattern], frames: Sequence[Image]) -> Ghost | None:
    return corrections_to(patterns, frames, SCENE.projector).ghost


@pytest.mark.parametrize("share", [0.1, 0.3])
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_ghosting_is_detected_and_corrected(sequence: str, share: float) -> None:
    patterns = SEQUENCES[sequence]
    frames = ghostly(SCENE.frames(patterns), share)
    found = ghost_of(patterns, frames)
    assert found is not None
    assert found.place is None
    assert share - 0.02 < found.share < share + 0.02
    plan = plan_sequence(patterns, SCENE.projector)
    without = [*CorrectedFrames(plan, np.array(frames, np.uint8), FrameCorrections(ghost=found)).read()]
    assert ghost_of(patterns, without) is None
    decoding = decode(patterns, frames, SCENE.projector)
    limit = 0.4 if sequence == "gray" else 0.08
    assert 0.005 < np.median(np.abs(SCENE.errors(decoding))) < limit
    assert the_only("ghost", decoding.findings).number("ghost_share") == pytest.approx(found.share, abs=0.005)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_other_light_is_not_taken_for_ghosting(sequence: str) -> None:
    patterns = SEQUENCES[sequence]
    rng = np.random.default_rng(3)
    still = SCENE.frames(patterns)
    flickering = [np.rint(frame * rng.uniform(0.7, 0.95)).astype(np.uint8) for frame in still]
    switched = [frame if number < 9 else np.minimum(frame, 225) + np.uint8(30) for number, frame in enumerate(still)]
    for frames in (still, flickering, switched):
        assert ghost_of(patterns, frames) is None


def test_a_clipped_pixel_stays_masked() -> None:
    scene = replace(SCENE, exposure=330.0)
    patterns = SEQUENCES["standard"]
    frames = ghostly(scene.frames(patterns), 0.2)
    clipped = np.mean(np.maximum.reduce(frames) == 255)
    assert 0.05 < clipped < 0.9
    without = decode(patterns, frames, SCENE.projector)
    assert np.median(np.abs(scene.errors(without))) < 0.08


@pytest.mark.parametrize("share", [0.35, 0.5])
@pytest.mark.parametrize("sequence", ["quick", "gray", "standard"])
def test_a_single_late_frame_is_detected_and_corrected(sequence: str, share: float) -> None:
    """Each of the coarse bits in turn, exposed while the projector still showed the previous picture."""
    patterns = SEQUENCES[sequence]
    frames = SCENE.frames(patterns)
    bits = [n for n, pattern in enumerate(patterns) if isinstance(pattern, Gray) and 2 <= pattern.bit <= 4]
    for place in bits[::5]:
        late = frames.copy()
        late[place] = np.rint((1 - share) * frames[place].astype(float) + share * frames[place - 1]).astype(np.uint8)
        found = ghost_of(patterns, late)
        assert found is not None, place
        assert found.place == place
        assert share - 0.04 < found.share < share + 0.04
        decoding = decode(patterns, late, SCENE.projector)
        errors = np.abs(SCENE.errors(decoding))
        assert np.mean(errors > 1.2) < 0.005
        assert 0.005 < np.median(errors) < (0.4 if sequence == "gray" else 0.08)
        said = the_only("ghost", decoding.findings)
        assert said.message.startswith(f"Frame {place} (")
        assert said.number("ghost_share") == pytest.approx(found.share, abs=0.005)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_wrong_frames_are_not_taken_for_late_ones(sequence: str) -> None:
    """Exchanged, repeated, inverted or brighter frames are left to other checks."""
    patterns = SEQUENCES[sequence]
    still = SCENE.frames(patterns)
    for place in range(3, len(still), 13):
        wrong = [{place: 255 - still[place]}, {place: np.rint(0.6 * still[place]).astype(np.uint8)}]
        for other in (place - 1, place - 2, len(still) - place // 2 - 1):
            wrong += [{place: still[other], other: still[place]}, {place: still[other]}]
        for changed in wrong:
            assert ghost_of(patterns, [changed.get(number, frame) for number, frame in enumerate(still)]) is None


FIVE = sequence_for(SCENE.projector, periods=(16.0, 6.7), shifts=5)


@pytest.mark.parametrize("odd", [0, 1])
@pytest.mark.parametrize("patterns", [*SEQUENCES.values(), FIVE], ids=[*SEQUENCES, "five steps"])
def test_half_of_the_rows_may_be_late(patterns: Sequence[Pattern], odd: int) -> None:
    """Interlaced: every second row still shows a quarter of the previous picture; the first picture
    was shown for long.
    """
    frames = SCENE.frames(patterns)
    late = [frames[0], *ghostly(frames, 0.25)[1:]]
    for mixed, frame in zip(late, frames, strict=True):
        mixed[1 - odd :: 2] = frame[1 - odd :: 2]
    found = ghost_of(patterns, late)
    assert found is not None
    shares = found.share, found.of_odd_rows
    assert shares[odd] == pytest.approx(0.25, abs=0.02)
    assert shares[1 - odd] == pytest.approx(0, abs=0.02)
    decoding = decode(patterns, late, SCENE.projector)
    assert 0.005 < np.median(np.abs(SCENE.errors(decoding))) < (0.4 if patterns is SEQUENCES["gray"] else 0.08)
    assert np.mean(np.abs(SCENE.errors(decoding)) > 1.2) < 0.005
    assert "in even and in odd rows" in the_only("ghost", decoding.findings).message
