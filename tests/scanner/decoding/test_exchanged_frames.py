"""Frames that do not show what the capture says: an error that names them, or no harm; never a wrong answer."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib.numerics import Image
from calib.refusal import RefusalError
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.patterns import Black, Gray, Pattern, White, gray_sequence, sequence_for
from tests.support.synthetic_capture import Scene, decode, fringes

SCENE = Scene(camera=(200, 150), indirect=0.3)
SIZE = SCENE.projector
STANDARD = sequence_for(SIZE)
THREE_SHIFTS = sequence_for(SIZE, shifts=3, inverses=False)[2:]
BARE_CODE = sequence_for(SIZE, shifts=0, cell=4, inverses=False)[2:]
CODE = sequence_for(SIZE, shifts=0, cell=4)
LONG_CELLS = (*fringes([50, 100 / 3], 3), *gray_sequence("x", 300, 50), *gray_sequence("y", 200, 50), White(), Black())
PERIODS = fringes([320, 40, 16], 4)


def exchanged(frames: Sequence[Image], *pairs: tuple[int, int]) -> list[Image]:
    result = list(frames)
    for i, j in pairs:
        result[i], result[j] = result[j], result[i]
    return result


def outcome(patterns: Sequence[Pattern], frames: Sequence[Image]) -> str:
    """The error's message, or '' if the coordinates are right in spite of the frames."""
    try:
        decoding = decode(patterns, frames, SIZE)
    except InputError as error:
        return str(error)
    errors = np.abs(SCENE.errors(decoding)).max(axis=1)
    assert len(errors) > 0
    assert np.median(errors) < 0.3
    assert np.mean(errors > 3) < 0.02
    return ""


@pytest.mark.parametrize(
    ("patterns", "one_in"),
    [(BARE_CODE, 4), (THREE_SHIFTS, 29)],
    ids=["a code without inverses", "a code without inverses, three shifts"],
)
def test_any_two_frames_exchanged(patterns: Sequence[Pattern], one_in: int) -> None:
    """Some of the pairs: each frame is exchanged with every `one_in`-th."""
    frames = SCENE.frames(patterns)
    assert outcome(patterns, frames) == ""
    pairs = [(i, j) for i, j in combinations(range(len(patterns)), 2) if (i + j) % one_in == 0]
    messages = [(i, j, outcome(patterns, exchanged(frames, (i, j)))) for i, j in pairs]
    raised = [(i, j, message) for i, j, message in messages if message]
    named = [f"frame {i} " in message or f"frame {j} " in message for i, j, message in raised]
    assert len(raised) > 0.95 * len(pairs)
    assert np.mean(named) > 0.94


@pytest.mark.parametrize(
    "patterns",
    [
        STANDARD,
        CODE,
        LONG_CELLS,
        PERIODS,
        STANDARD[2:],
        sequence_for(SIZE, shifts=4, inverses=False),
        sequence_for(SIZE, code="xor", inverses=False),
        sequence_for(SIZE, code="both"),
    ],
    ids=[
        "standard",
        "code",
        "cell as long as the period",
        "fringes only",
        "no white and black",
        "no inverses",
        "XOR code",
        "both codes",
    ],
)
@settings(max_examples=1, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_selection_of_two_frames_exchanged(patterns: Sequence[Pattern], data: st.DataObject) -> None:
    i, j = data.draw(st.lists(st.integers(0, len(patterns) - 1), min_size=2, max_size=2, unique=True))
    outcome(patterns, exchanged(SCENE.frames(patterns), (i, j)))


def index(patterns: Sequence[Pattern], axis: str, bit: int, *, inverted: bool = False) -> int:
    return next(
        k
        for k, p in enumerate(patterns)
        if isinstance(p, Gray) and (p.axis, p.bit, p.inverted) == (axis, bit, inverted)
    )


@pytest.mark.parametrize("patterns", [CODE, STANDARD], ids=["code", "standard"])
@pytest.mark.parametrize("bit", [0, 1, 4])
def test_a_bit_exchanged_with_its_inverse(patterns: Sequence[Pattern], bit: int) -> None:
    pair = index(patterns, "x", bit), index(patterns, "x", bit, inverted=True)
    assert "along x" in outcome(patterns, exchanged(SCENE.frames(patterns), pair)) or bit == 0


def test_the_first_bit_exchanged_with_its_inverse_mirrors_the_image() -> None:
    # 256 columns: the mirrored code is as good as the right one, but no camera sees a projector's image mirrored.
    scene = replace(SCENE, projector=(256, 200))
    patterns = sequence_for(scene.projector, shifts=0, cell=4)
    pair = index(patterns, "x", 0), index(patterns, "x", 0, inverted=True)
    with pytest.raises(InputError, match=r"x coordinate runs backwards.*frame 2 \(gray x bit 0\)"):
        decode(patterns, exchanged(scene.frames(patterns), pair), scene.projector)


@pytest.mark.parametrize(("first", "second"), [(("x", 1), ("x", 4)), (("y", 2), ("y", 3)), (("x", 3), ("y", 3))])
@pytest.mark.parametrize("patterns", [CODE, STANDARD], ids=["code", "standard"])
def test_bits_exchanged_together_with_their_inverses(
    patterns: Sequence[Pattern], first: tuple[str, int], second: tuple[str, int]
) -> None:
    pairs = [(index(patterns, *first, inverted=i), index(patterns, *second, inverted=i)) for i in (False, True)]
    message = outcome(patterns, exchanged(SCENE.frames(patterns), *pairs))
    assert f"frame {pairs[0][0]} " in message or f"frame {pairs[0][1]} " in message


FINE = sequence_for(SIZE, shifts=0, cell=1)


@pytest.mark.parametrize("bits", [(1, 2), (2, 4), (3, 8), (6, 7)])
def test_bits_exchanged_where_camera_pixels_see_several_cells(bits: tuple[int, int]) -> None:
    scene = replace(SCENE, camera=(120, 90), indirect=0.15)
    frames = scene.frames(FINE)
    assert np.median(np.abs(scene.errors(decode(FINE, frames, SIZE)))) < 0.35
    pairs = [tuple(index(FINE, "x", bit, inverted=inverted) for bit in bits) for inverted in (False, True)]
    with pytest.raises(InputError, match=rf"frame {pairs[0][0]} |frame {pairs[0][1]} "):
        decode(FINE, exchanged(frames, *((a, b) for a, b in pairs)), SIZE)


@pytest.mark.parametrize("inverses", [True, False])
def test_the_finest_bit_shown_by_the_one_before_it(inverses: bool) -> None:
    patterns = sequence_for(SIZE, shifts=0, cell=1, inverses=inverses)
    scene = replace(SCENE, camera=(300, 225), indirect=0.15)
    frames = scene.frames(patterns)
    last = max(p.bit for p in patterns if isinstance(p, Gray) and p.axis == "x")
    for inverted in (False, True)[: 1 + inverses]:  # with noise of its own: a copy of the frame is told apart as late
        place, before = (index(patterns, "x", bit, inverted=inverted) for bit in (last, last - 1))
        frames[place] = scene.frame(patterns[before], place)
    with pytest.raises(InputError, match=rf"cells of the Gray code do not follow.*gray x bit {last}\)"):
        decode(patterns, frames, SIZE)


def test_a_projector_that_moves_before_the_finest_bit() -> None:
    scene = replace(SCENE, camera=(300, 225), indirect=0.15)
    moved = replace(scene, turn_deg=scene.turn_deg + 1.5)
    first = index(FINE, "x", max(p.bit for p in FINE if isinstance(p, Gray) and p.axis == "x"))
    frames = [(scene if number < first else moved).frame(p, number) for number, p in enumerate(FINE)]
    with pytest.raises((InputError, RefusalError), match=r"gray x bit 8\)"):
        decode(FINE, frames, SIZE)


def test_x_and_y_exchanged() -> None:
    scene = replace(SCENE, projector=(256, 256))
    patterns = sequence_for(scene.projector, cell=8, shifts=4)
    other = [next(k for k, q in enumerate(patterns) if q == swapped(p)) for p in patterns]
    frames = scene.frames(patterns)
    with pytest.raises(InputError, match="runs backwards"):
        decode(patterns, [frames[k] for k in other], scene.projector)


def swapped(pattern: Pattern) -> Pattern:
    if isinstance(pattern, White | Black):
        return pattern
    return replace(pattern, axis="y" if pattern.axis == "x" else "x")


def test_a_frame_twice_in_place_of_another() -> None:
    frames = SCENE.frames(STANDARD)
    frames[6] = frames[9]
    assert "frame 6 (gray x bit 2)" in outcome(STANDARD, frames)


def test_nothing_but_darkness() -> None:
    rng = np.random.default_rng(0)
    frames = [np.clip(rng.normal(6, 1.5, (150, 200)).round(), 0, 255).astype(np.uint8) for _ in STANDARD]
    assert "no pixel changes clearly" in outcome(STANDARD, frames)
    assert "no pixel changes clearly" in outcome(STANDARD, [np.full((150, 200), 7, np.uint8) for _ in STANDARD])


def test_nothing_but_glare() -> None:
    frames = replace(SCENE, exposure=30000.0, ambient=200.0).frames(STANDARD)
    assert "overexposed" in outcome(STANDARD, frames)


def test_missing_frames() -> None:
    decoder = Decoder(STANDARD, SIZE)
    for frame in SCENE.frames(STANDARD)[:7]:
        decoder.add(frame)
    with pytest.raises(InputError, match=r"40 frames, found 7; .* frame 7 \(gray x bit 2 inverted\)"):
        decoder.finish()


def test_one_frame_too_many() -> None:
    frames = SCENE.frames(BARE_CODE)
    with pytest.raises(InputError, match="13 frames, found one more"):
        decode(BARE_CODE, [*frames, frames[0]], SIZE)


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (
            np.zeros((150, 199), np.uint8),
            r"frame 4 \(gray x bit 4\): expected .* 200 × 150 grey, 8 bits, found 199 × 150",
        ),
        (np.zeros((150, 200), np.uint16), "found 200 × 150 grey, 16 bits"),
        (np.zeros((150, 200, 3), np.uint8), "found 200 × 150 BGR, 8 bits"),
        (np.zeros((150, 200, 4), np.uint8), "expected a grey or BGR image"),
        (np.zeros((150, 200), np.float32), "expected a grey or BGR image of 8 or 16 bits"),
    ],
)
def test_a_frame_of_another_shape(frame: Image, said: str) -> None:
    decoder = Decoder(BARE_CODE, SIZE)
    for good in SCENE.frames(BARE_CODE)[:4]:
        decoder.add(good)
    with pytest.raises(InputError, match=said):
        decoder.add(frame)
