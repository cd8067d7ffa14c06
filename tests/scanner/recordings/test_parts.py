"""The video, the tone curve, and the weights of frames, each compared with its definition."""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.geometry import Size
from scanner.patterns import PRESETS, draw
from scanner.recordings.averaging import image_of
from scanner.recordings.clocks import Clocks, Loop
from scanner.recordings.programme import (
    BLACK,
    FRAMES_PER_SECOND,
    LEAD_IN_S,
    WHITE,
    Programme,
    programme_of,
    write_player_video,
)
from scanner.recordings.samples import VideoSamples
from scanner.recordings.steadiness import moved_px
from scanner.recordings.video_file import LumaCodes, ToneCurve, VideoFile
from scanner.recordings.weights import picture_weights

HEIGHT = 24


def programme(hold_s: float, loops: int = 1) -> Programme:
    return programme_of(PRESETS["quick"].patterns((32, 18)), Size(32, 18), hold_s, loops)


def test_a_video_shows_each_picture_for_its_duration(tmp_path: Path) -> None:
    shown = programme(0.05, loops=2)
    write_player_video(tmp_path / "video.mp4", shown)
    with av.open(str(tmp_path / "video.mp4")) as container:
        frames = [(frame.time, frame.to_ndarray(format="gray")) for frame in container.decode(video=0)]
    times = [time for time, _ in frames]
    assert np.allclose(np.diff(times), 1 / FRAMES_PER_SECOND, atol=1e-4)
    assert times[-1] == pytest.approx(shown.length_s, abs=0.02)
    for slot, number in enumerate(shown.slots):
        seen = frames[round((LEAD_IN_S + (slot + 0.5) * shown.hold_s) * FRAMES_PER_SECOND)][1]
        fields = {WHITE: 255, BLACK: 0}
        wanted = fields[number] if number in fields else draw(shown.patterns[number], shown.size)
        assert np.abs(seen.astype(float) - wanted).max() < 4


@given(hold_s=st.floats(0.05, 2.0), loops=st.integers(1, 20))
def test_pictures_last_an_odd_number_of_frames(hold_s: float, loops: int) -> None:
    frames = programme(hold_s, loops).hold_s * FRAMES_PER_SECOND
    assert frames == pytest.approx(round(frames))
    assert round(frames) % 2 == 1
    assert -1e-4 < frames - hold_s * FRAMES_PER_SECOND < 2


@given(exponent=st.floats(1.0, 4.0), contrast=st.floats(-0.9, 0.9))
def test_a_tone_curve_rises_from_zero_to_one(exponent: float, contrast: float) -> None:
    light = ToneCurve(exponent, contrast).light(np.linspace(0, 1, 200))
    assert np.all(np.diff(light) > 0)
    assert light[[0, -1]] == pytest.approx([0, 1])


@pytest.mark.parametrize(("black", "white", "codes"), [(16, 235, 256), (64, 940, 1024), (0, 255, 256)])
def test_luma_has_the_range_stated_in_its_file(black: int, white: int, codes: int) -> None:
    light = LumaCodes(black, white).light(ToneCurve(1.0, 0.0))
    assert len(light) == codes
    assert light[[black, white]] == pytest.approx([0, 1])
    assert light[(black + white) // 2] == pytest.approx(0.5, abs=0.003)


@settings(max_examples=8)
@given(
    exposure_s=st.floats(0.001, 0.04),
    readout_s=st.floats(-0.02, 0.03),
    start_s=st.floats(0.0, 0.3),
    hold_s=st.sampled_from([0.08, 0.12, 0.2]),
    loops=st.integers(1, 3),
)
def test_weighted_frames_contain_their_picture_only(
    exposure_s: float, readout_s: float, start_s: float, hold_s: float, loops: int
) -> None:
    shown = programme(hold_s, loops)
    length_s = shown.slots_between_marks * shown.hold_s
    found = tuple(Loop(start_s + loop * (length_s + 0.011), shown.hold_s) for loop in range(loops))
    shifts = tuple(np.zeros(len(shown.loop) + 1) for _ in found)
    clocks = Clocks(exposure_s, readout_s / HEIGHT, found, shifts, ToneCurve(), 0.0, (exposure_s, exposure_s))
    times_s = np.arange(0, (loops + 1) * length_s + 1, 1 / 24)
    video = VideoFile(Path("film.mp4"), Size(32, HEIGHT), 0, LumaCodes(16, 235), len(times_s), shown.length_s)
    rows = np.arange(0.0, HEIGHT, 6)
    # A film of white: what frames show is no matter here.
    codes = np.full((len(times_s), len(rows), 4), 200, np.uint8)
    codes[times_s > found[-1].start_s + len(shown.loop) * shown.hold_s] = 16
    samples = VideoSamples(codes, times_s, rows, video)
    begins = times_s[:, None] + (np.arange(HEIGHT) - samples.middle_row) * clocks.line_s - exposure_s / 2
    for pattern, weights in enumerate(picture_weights(samples, shown, clocks)):
        got = np.zeros((len(shown.patterns) + 2, HEIGHT))
        for loop in range(loops):
            changes = clocks.changes(loop)
            for slot, number in enumerate(shown.loop[:-1]):
                ends = np.minimum(begins + exposure_s, changes[slot + 1])
                shares = np.clip(ends - np.maximum(begins, changes[slot]), 0, None) / exposure_s
                got[number] += np.sum(weights.weights * shares[weights.numbers], axis=0)
        kept = weights.weights.any(axis=0)
        assert np.abs(got[pattern, kept] - 1).max(initial=0) < 0.11
        assert np.abs(np.delete(got, pattern, axis=0)[:, kept]).max(initial=0) < 0.11
        assert np.all(weights.noise[kept] < 4)


@pytest.mark.parametrize("shift_px", [0.0, 0.7, 1.5])
def test_a_shift_of_the_picture_is_measured(shift_px: float) -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (240, 320)), (0, 0), 2.0) * 3 - 255
    moved = cv2.warpAffine(texture, np.array([[1, 0, shift_px], [0, 1, 0]]), (320, 240), borderMode=cv2.BORDER_REFLECT)
    whites = {0: np.clip(texture, 0, 255).astype(np.uint8), 9: np.clip(moved, 0, 255).astype(np.uint8)}
    assert 0.7 * shift_px <= moved_px(whites) <= 1.1 * shift_px + 0.1


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_frames_are_rotated_upright(turns: int) -> None:
    light = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    image = image_of(light, turns)
    assert image.shape == ((3, 4) if turns % 2 == 0 else (4, 3))
    assert np.array_equal(np.rot90(image, -turns), np.rint(light * 65_535).astype(np.uint16))
