"""Light that is switched on or off between two frames: found by the light of fringes, and taken out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.numerics.array_types import Image
from scanner.decoding import LightSwitchedError
from scanner.decoding.decoder import Decoder, Decoding
from scanner.errors import InputError
from scanner.patterns import sequence_for
from scanner.patterns.pattern import Pattern
from scanner.patterns.presets import PRESETS
from tests.support.synthetic_capture import Scene, decode

SCENE = replace(Scene(), exposure=150.0)
QUICK = PRESETS["quick"].patterns(SCENE.projector)
CONCAVE = PRESETS["concave"].patterns(SCENE.projector)
GRAY = sequence_for(SCENE.projector, code="gray", cell=1, inverses=True, shifts=0)


def switched(frames: Sequence[Image], number: int, share: float) -> list[Image]:
    """From a frame on there is a lamp, or no longer."""
    lamp = share * frames[0].astype(np.float64)
    dark = np.abs(min(share, 0)) * frames[0]
    shown = [frame + dark + (k >= number) * lamp for k, frame in enumerate(frames)]
    return [np.rint(np.minimum(frame, 255)).astype(np.uint8) for frame in shown]


def decode_once_more(patterns: Sequence[Pattern], frames: Sequence[Image]) -> Decoding:
    decoder = Decoder(patterns, SCENE.projector)
    for frame in frames:
        decoder.add(frame)
    with pytest.raises(LightSwitchedError) as found:
        decoder.finish(once_more=True)
    decoder = Decoder(patterns, SCENE.projector, switch=found.value.switch)
    for place, frame in enumerate(frames):
        decoder.measure_light(place, frame)
    for frame in frames:
        decoder.add(frame)
    return decoder.finish()


@pytest.mark.parametrize("number", [9, 10])
def test_light_that_comes_up_while_a_frame_is_exposed_is_told_before_either(number: int) -> None:
    """Half of it is in the frame: nothing tells whether it came before it or after it, and both are named."""
    frames = SCENE.frames(GRAY)
    after = switched(frames, number, 0.3)
    half = np.rint((frames[number].astype(np.float64) + after[number]) / 2).astype(np.uint8)
    decoding = decode_once_more(GRAY, [*after[:number], half, *after[number + 1 :]])
    (said,) = [warning for warning in decoding.warnings if "was switched on before" in warning]
    assert f"frame {number} (" in said
    assert f"frame {number + 1} (" in said
    clear = decode_once_more(GRAY, after)
    (said,) = [warning for warning in clear.warnings if "was switched on before" in warning]
    assert " or frame" not in said


@pytest.mark.parametrize(
    ("patterns", "number", "share"),
    [
        (QUICK, 2, 0.3),  # before all codes
        (QUICK, 9, 0.3),  # within them
        (QUICK, len(QUICK) - 5, 0.1),  # within the fringes along y
        (QUICK, len(QUICK) - 5, -0.2),
        (CONCAVE, 6, 0.3),
        (GRAY, 2, 0.6),  # before all pairs but that of white and black
        (GRAY, 1, 0.6),
    ],
)
def test_switched_light_is_taken_out(patterns: Sequence[Pattern], number: int, share: float) -> None:
    frames = SCENE.frames(patterns)
    decoding = decode_once_more(patterns, switched(frames, number, share))
    errors = np.abs(SCENE.errors(decoding))
    assert 0.01 < np.median(errors) < 0.06
    assert np.mean(errors > 3) < 0.005
    assert np.mean(decoding.reasons[SCENE.well_lit()] == 0) > 0.97
    went = "on" if share > 0 else "off"
    assert any(f"switched {went} before frame {number} (" in warning for warning in decoding.warnings)


@pytest.mark.parametrize(("one", "other"), [(0, 8), (1, 5), (4, 12), (3, len(QUICK) - 2)])
def test_exchanged_frames_are_no_light(one: int, other: int) -> None:
    frames = SCENE.frames(QUICK)
    frames[one], frames[other] = frames[other], frames[one]
    decoder = Decoder(QUICK, SCENE.projector)
    for frame in frames:
        decoder.add(frame)
    with pytest.raises(InputError, match=f"frame {one} |frame {other} "):
        decoder.finish(once_more=True)


def test_steady_light_needs_no_second_look() -> None:
    decoder = Decoder(QUICK, SCENE.projector)
    frames = SCENE.frames(QUICK)
    for frame in frames:
        decoder.add(frame)
    found = decoder.finish(once_more=True).matches
    assert np.array_equal(found.projector_px, decode(QUICK, frames, SCENE.projector).matches.projector_px)
