"""Effects of an encoder and a slow panel on fringes are measured, or cancel, in a forward and a backward pass."""

import numpy as np
import pytest

from calib.geometry import Size
from calib.numerics import Floats
from scanner.patterns import PRESETS, Phase
from scanner.recordings.averaging import Averaged, smooth_px
from scanner.recordings.programme import Programme
from scanner.recordings.weights import PictureWeights

HEIGHT, WIDTH = 120, 160
PROGRAMME = Programme(PRESETS["standard"].patterns((64, 48)), Size(64, 48), 0.2, 1)
SHORTEST = 6.7
MODES = 10


def of_two_passes(half: Floats, noise: float = 0.0, back: bool = True) -> tuple[list[PictureWeights], Averaged]:
    """Pictures of a wall whose fringes have phases of ± `half` (H, W) radians in the two passes."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    passes = np.zeros((2, len(PROGRAMME.patterns), HEIGHT, WIDTH), np.float32)
    for number, pattern in enumerate(PROGRAMME.patterns):
        if isinstance(pattern, Phase):
            along = (x if pattern.axis == "x" else y) / pattern.period + pattern.shift
            for one, sign in enumerate((-1, 1)):
                seen = 0.5 + 0.4 * np.cos(2 * np.pi * along + sign * half) + noise * rng.standard_normal(half.shape)
                passes[one, number] = seen / 2  # of a picture's two halves
    of_frames = np.array([False, back])
    weights = PictureWeights(np.arange(2), np.full((2, HEIGHT), 0.5), of_frames, np.ones(HEIGHT), 1.0)
    pictures = passes.sum(axis=0)
    return [weights] * len(pictures), Averaged(pictures, {}, passes, 1)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("size", [0.002, 0.02])
def test_smooth_errors_follow_from_the_difference_of_the_passes(size: float, noise: float) -> None:
    slope = np.broadcast_to(np.linspace(-size, size, WIDTH), (HEIGHT, WIDTH))
    found = smooth_px(PROGRAMME, *of_two_passes(slope, noise))
    assert found is not None
    seen = SHORTEST / (2 * np.pi) * np.sqrt(np.mean(slope**2) / MODES)
    assert 1.8 * seen < found < 2.2 * seen


def test_independent_pixel_errors_give_no_smooth_error() -> None:
    found = smooth_px(PROGRAMME, *of_two_passes(np.zeros((HEIGHT, WIDTH)), noise=0.02))
    assert found is not None
    # Of 0.02 of an amplitude of 0.4, in the mean over 4,800 pixels.
    assert found < 0.5 * SHORTEST / (2 * np.pi) * 0.05 / np.sqrt(4800)


def test_one_pass_gives_no_result() -> None:
    assert smooth_px(PROGRAMME, *of_two_passes(np.zeros((HEIGHT, WIDTH)), back=False)) is None


@pytest.mark.parametrize("ghost", [0.003, 0.03])
def test_ghosting_shifts_no_fringe(ghost: float) -> None:
    rng = np.random.default_rng(0)
    at = dict(zip("xy", rng.uniform(0, 60, (2, 20_000)), strict=True))
    light = [
        0.5 + 0.5 * np.cos(2 * np.pi * (at[pattern.axis] / pattern.period + pattern.shift))
        if isinstance(pattern, Phase)
        else rng.choice([0.0, 1.0], 20_000)
        for pattern in PROGRAMME.patterns
    ]

    def shift_of(axis: str, passes: slice) -> float:
        """Mean phase error of the shortest fringe."""
        total = np.zeros(20_000, np.complex128)
        for number, pattern in enumerate(PROGRAMME.patterns):
            if isinstance(pattern, Phase) and (pattern.axis, pattern.period) == (axis, SHORTEST):
                before = [PROGRAMME.loop[slot - 1] for slot in PROGRAMME.slots_of(number)]
                seen = [(1 - ghost) * light[number] + ghost * light[each] for each in before if each >= 0][passes]
                total += np.mean(seen, axis=0) * np.exp(-2j * np.pi * pattern.shift)
        return float(np.mean(np.angle(total * np.exp(-2j * np.pi * at[axis] / SHORTEST))))

    assert 0.6 * ghost < abs(shift_of("y", slice(0, 1))) < 0.9 * ghost
    for axis in "xy":
        assert abs(shift_of(axis, slice(0, 2))) < 0.05 * ghost
