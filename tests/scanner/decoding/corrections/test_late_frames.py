"""Frames that are the ones before them, bit for bit: left out and named, wherever they are in a sequence."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.numerics import Image
from scanner.decoding import Decoder, Decoding
from scanner.errors import InputError
from scanner.patterns import PRESETS, Black, Gray, Pattern, White, draw, gray_sequence

SIZE = (214, 120)
PAIRS: list[Pattern] = [White(), Black(), *gray_sequence("x", SIZE[0], 1), *gray_sequence("y", SIZE[1], 1)]
PLAIN: list[Pattern] = [p for p in PAIRS if not isinstance(p, Gray) or not p.inverted]


def taken(patterns: list[Pattern], noise: float = 0.7) -> list[Image]:
    """What a camera takes that sees exactly the projector's picture."""
    random = np.random.default_rng(0)
    levels = [20 + 0.6 * draw(pattern, SIZE) for pattern in patterns]
    return [np.rint(level + random.normal(0, noise, level.shape)).astype(np.uint8) for level in levels]


def decoded(patterns: list[Pattern], frames: list[Image], late: list[int]) -> Decoding:
    """The result of a capture of which some frames are the ones before them."""
    decoder = Decoder(patterns, SIZE)
    kept = list(frames)
    for place in sorted(late):
        kept[place] = kept[place - 1]
    for frame in kept:
        decoder.add(frame)
    return decoder.finish()


def named(decoding: Decoding) -> list[tuple[float, ...]]:
    return [tuple(f.numbers("frames")) for f in decoding.findings if f.kind.name == "late-frames"]


FRAMES = taken(PAIRS)


@cache
def matches_without_late_frames() -> int:
    return len(decoded(PAIRS, FRAMES, []).matches)


@settings(max_examples=20)
@given(place=st.integers(1, len(PAIRS) - 1))
def test_what_a_late_frame_should_show_follows_from_the_others(place: int) -> None:
    decoding = decoded(PAIRS, FRAMES, [place])
    assert named(decoding) == [(place,)]
    error = decoding.matches.projector_px - decoding.matches.camera_px
    assert 0.9 * matches_without_late_frames() < len(decoding.matches) <= SIZE[0] * SIZE[1]
    assert np.quantile(np.abs(error), 0.99) <= 0.5


def test_several_late_frames_are_left_out() -> None:
    decoding = decoded(PAIRS, FRAMES, [5, 17, len(PAIRS) - 1])
    assert named(decoding) == [(5, 17, len(PAIRS) - 1)]
    assert len(decoding.matches) > 0.9 * matches_without_late_frames()


def test_a_late_step_of_a_fringe_is_left_out() -> None:
    patterns = [*PRESETS["standard"].patterns(SIZE)]
    decoding = decoded(patterns, taken(patterns), [len(patterns) - 2])
    assert named(decoding) == [(len(patterns) - 2,)]
    assert np.quantile(np.abs(decoding.matches.projector_px - decoding.matches.camera_px), 0.99) < 0.3


def test_without_inverses_the_finest_bit_is_given_up_and_a_coarse_one_is_missed() -> None:
    finest = next(n for n, p in enumerate(PLAIN) if isinstance(p, Gray) and p.axis == "x" and p.bit == p.bits - 1)
    frames = taken(PLAIN)
    decoding = decoded(PLAIN, frames, [finest])
    assert named(decoding) == [(finest,)]
    assert np.quantile(np.abs(decoding.matches.projector_px - decoding.matches.camera_px), 0.99) <= 1
    with pytest.raises(InputError, match=r"frame 2 .* is the frame before it, bit for bit"):
        decoded(PLAIN, frames, [2])


def test_without_noise_and_late_frames_nothing_is_named() -> None:
    assert named(decoded(PAIRS, FRAMES, [])) == []
    frames = taken(PAIRS, 0)
    assert named(decoded(PAIRS, frames, [])) == []
