"""Ambient light switched on or off between two frames is detected in the sums of fringes, and removed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.numerics import Image
from scanner.errors import InputError
from scanner.patterns import PRESETS, Pattern, sequence_for
from tests.support.findings import kinds_of, the_only
from tests.support.synthetic_capture import Scene, decode

SCENE = replace(Scene(), exposure=150.0)
QUICK = PRESETS["quick"].patterns(SCENE.projector)
CONCAVE = PRESETS["concave"].patterns(SCENE.projector)
GRAY = sequence_for(SCENE.projector, code="gray", cell=1, inverses=True, shifts=0)


def switched(frames: Sequence[Image], number: int, share: float) -> list[Image]:
    """Add a lamp from a frame on, or until then."""
    lamp = share * frames[0].astype(np.float64)
    dark = np.abs(min(share, 0)) * frames[0]
    shown = [frame + dark + (k >= number) * lamp for k, frame in enumerate(frames)]
    return [np.rint(np.minimum(frame, 255)).astype(np.uint8) for frame in shown]


@pytest.mark.parametrize("number", [9, 10])
def test_a_change_during_an_exposure_is_reported_for_either_frame(number: int) -> None:
    """Half of the light is in one frame: the change may be before or after it, and both frames are named."""
    frames = SCENE.frames(GRAY)
    after = switched(frames, number, 0.3)
    half = np.rint((frames[number].astype(np.float64) + after[number]) / 2).astype(np.uint8)
    decoding = decode(GRAY, [*after[:number], half, *after[number + 1 :]], SCENE.projector)
    said = the_only("light-switched", decoding.findings).message
    assert "switched on before" in said
    assert f"frame {number} (" in said
    assert f"frame {number + 1} (" in said
    clear = decode(GRAY, after, SCENE.projector)
    said = the_only("light-switched", clear.findings).message
    assert "switched on before frame" in said
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
def test_switched_light_is_removed(patterns: Sequence[Pattern], number: int, share: float) -> None:
    frames = SCENE.frames(patterns)
    decoding = decode(patterns, switched(frames, number, share), SCENE.projector)
    errors = np.abs(SCENE.errors(decoding))
    assert 0.01 < np.median(errors) < 0.06
    assert np.mean(errors > 3) < 0.005
    assert np.mean(decoding.reasons[SCENE.well_lit()] == 0) > 0.97
    went = "on" if share > 0 else "off"
    said = the_only("light-switched", decoding.findings)
    assert f"switched {went} before frame {number} (" in said.message
    assert said.numbers("frames") == (number,)


@pytest.mark.parametrize(("one", "other"), [(0, 8), (1, 5), (4, 12), (3, len(QUICK) - 2)])
def test_exchanged_frames_are_not_taken_for_switched_light(one: int, other: int) -> None:
    frames = SCENE.frames(QUICK)
    frames[one], frames[other] = frames[other], frames[one]
    with pytest.raises(InputError, match=f"frame {one} |frame {other} "):
        decode(QUICK, frames, SCENE.projector)


def test_steady_light_changes_nothing() -> None:
    found = decode(QUICK, SCENE.frames(QUICK), SCENE.projector)
    assert not {"ghost", "light-switched"} & {*kinds_of(found.findings)}
    assert 0.01 < np.median(np.abs(SCENE.errors(found))) < 0.06
