"""Clouds of six frames compared with the truth: true sigmas at rest, and correct masks in motion."""

from itertools import islice

import numpy as np
import pytest

from calib.geometry import intersect_rays
from calib.numerics import Bools, Floats
from scanner.configuration import Config
from scanner.live.cloud import LiveCloud, LiveDecoder
from scanner.live.first_look import FirstLook, look
from scanner.live.joining import matches_of
from scanner.live.rounds import best_sequence, take_rounds
from scanner.live.sequence import FRAMES, LiveSequence
from scanner.live.watching import proven
from tests.support.live_bench import LiveBench, calibration

DEPTHS = (0.35, 0.7)
_BEFORE = 29  # frames of the first look, and of the first round


def begun(bench: LiveBench, depths: tuple[float, float] | None = DEPTHS) -> tuple[FirstLook, LiveSequence, LiveDecoder]:
    seen = look(bench.rig, Config())
    sequence = best_sequence(bench.rig, seen, bench.calibration, depths)
    assert bench.taken == _BEFORE
    return seen, sequence, LiveDecoder(sequence, seen, bench.calibration)


def clouds_of(bench: LiveBench, number: int, depths: tuple[float, float] | None = DEPTHS) -> list[LiveCloud | None]:
    """The clouds of a number of rounds; None for dropped ones."""
    seen, sequence, decoder = begun(bench, depths)
    earlier: list[LiveCloud] = []
    taken = islice(take_rounds(bench.rig, sequence, seen.response), number)
    return [None if each is None else proven(decoder, each, earlier) for each in taken]


def errors(cloud: LiveCloud, bench: LiveBench, axis: int = 0) -> tuple[Floats, Floats, Bools]:
    """Errors in pixels and in sigmas, of the kept pixels, (H, W)."""
    middle = _BEFORE + FRAMES * cloud.taken.number + (FRAMES - 1) / 2
    off = cloud.coordinate - bench.truth(middle)[0][..., axis]
    kept = np.isfinite(cloud.coordinate)
    return off[kept], off[kept] / np.sqrt(cloud.variance[kept]), kept


@pytest.mark.parametrize("depths", [DEPTHS, None])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_errors_of_a_static_scene_match_their_sigmas(depths: tuple[float, float] | None, gamma: float) -> None:
    bench = LiveBench(gamma=gamma)
    cloud = clouds_of(bench, 2, depths)[1]
    assert cloud is not None
    off, in_sigmas, kept = errors(cloud, bench)
    assert 0.9 < np.count_nonzero(kept) / np.count_nonzero(np.isfinite(bench.truth(0)[0][..., 0])) <= 1
    assert 0.8 < np.quantile(np.abs(in_sigmas), 0.683) < 1.25
    assert np.mean(np.abs(in_sigmas) > 6) < 2e-3  # at the ball's rim, where a pixel sees two surfaces
    assert np.mean(np.abs(off) > 5) < 1e-3  # periods
    assert cloud.moving_share < 1e-3


def test_interreflection_causes_no_period_slip() -> None:
    bench = LiveBench(bounce=0.15)
    cloud = clouds_of(bench, 2, None)[1]
    assert cloud is not None
    off, _, kept = errors(cloud, bench)
    assert 0.3 < np.count_nonzero(kept) / np.count_nonzero(np.isfinite(bench.truth(0)[0][..., 0])) < 0.9
    assert np.mean(np.abs(off) > 5) < 2e-3


def test_points_and_sigmas_follow_from_rays_and_stripe_planes() -> None:
    bench = LiveBench(calibration=calibration(lens=-0.05))
    cloud = clouds_of(bench, 2)[1]
    assert cloud is not None
    matches = matches_of(cloud, 0, bench.calibration)
    met = intersect_rays(matches.camera_px, matches.projector_px, bench.calibration)
    assert len(matches) > 0.98 * len(cloud.points)
    assert np.abs(met.residual_px).max() < 1e-6
    kept = np.isin(cloud.pixel, matches.camera_px.astype(np.int64) @ [1, cloud.reason.shape[1]])
    np.testing.assert_allclose(cloud.points[kept], met.points, atol=1e-6)
    true = bench.truth(0)[1].reshape(-1, 3)[cloud.pixel]
    along = np.linalg.norm(cloud.points, axis=1) - np.linalg.norm(true, axis=1)
    assert 0.8 < np.quantile(np.abs(along / cloud.sigma), 0.683) < 1.25


def test_narrower_limits_make_finer_fringes() -> None:
    (_, wide, _), (_, narrow, _) = begun(LiveBench(), None), begun(LiveBench(), DEPTHS)
    assert wide.axis == narrow.axis == "x"
    assert 1.5 < wide.short_px / narrow.short_px < 4
    assert 2 * DEPTHS[0] < narrow.long_px / 100 < 4  # 560 px · 0.12 m · (1/0.35 − 1/0.7) = 96 px, and the same ×2.4


@pytest.mark.parametrize(("speed_m", "least_moving"), [((0.0003, 0.0, 0.0), 0.02), ((0.0, 0.0, -0.0003), 0.1)])
def test_a_ball_moving_at_10_mm_per_second_has_the_expected_errors(
    speed_m: tuple[float, float, float], least_moving: float
) -> None:
    """33 ms per frame, to the right or towards the camera."""
    bench = LiveBench(speed_m=speed_m)
    cloud = clouds_of(bench, 3)[2]
    assert cloud is not None
    middle = _BEFORE + FRAMES * cloud.taken.number + (FRAMES - 1) / 2
    _, in_sigmas, kept = errors(cloud, bench)
    ball = bench.on_ball(middle)
    assert least_moving < cloud.moving_share < 0.6
    assert np.count_nonzero(kept & ball) > 0.8 * np.count_nonzero(ball)
    of_ball = in_sigmas[ball[kept]]
    assert 0.6 < np.quantile(np.abs(of_ball), 0.683) < 1.25
    assert np.mean(np.abs(of_ball) > 6) < 0.01


def test_a_ball_that_moves_too_fast_is_masked() -> None:
    bench = LiveBench(speed_m=(0.0, 0.0, -0.004))
    cloud = clouds_of(bench, 3)[2]
    assert cloud is not None
    off, _, kept = errors(cloud, bench)
    ball = bench.on_ball(_BEFORE + 2 * FRAMES + 2.5)
    assert np.count_nonzero(kept & ball) < 0.1 * np.count_nonzero(ball)
    assert np.count_nonzero(kept & ~ball) > 0.5 * np.count_nonzero(~ball)
    assert np.mean(np.abs(off) > 2) < 0.01


@pytest.mark.parametrize("share", [1.0, 0.3, 0.05])
@pytest.mark.parametrize("which", range(FRAMES))
def test_a_late_frame_costs_one_cloud_and_makes_none_wrong(share: float, which: int) -> None:
    bench = LiveBench(late=frozenset([_BEFORE + 2 * FRAMES + which]), share=share)
    clouds = clouds_of(bench, 5)
    assert [cloud is None for cloud in clouds] == [True, False, True, False, False]
    for cloud in filter(None, clouds):
        assert np.quantile(np.abs(errors(cloud, bench)[1]), 0.683) < 1.25


def test_a_late_frame_in_the_first_round_costs_no_more() -> None:
    bench = LiveBench(late=frozenset([_BEFORE + 1]), share=0.3)
    assert [cloud is None for cloud in clouds_of(bench, 4)] == [True, True, False, False]


def test_a_lost_frame_costs_one_cloud() -> None:
    bench = LiveBench(lost=frozenset([_BEFORE + 2 * FRAMES + 3]))
    clouds = clouds_of(bench, 5)
    assert [cloud is None for cloud in clouds] == [True, False, True, False, False]
    assert [cloud.taken.number for cloud in clouds if cloud is not None] == [1, 3, 4]
