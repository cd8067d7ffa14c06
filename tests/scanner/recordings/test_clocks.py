"""Exposure, readout and the player's clock, from samples of films whose clocks are known."""

from dataclasses import replace

import numpy as np
import pytest

from scanner.recordings.clock_fit import fit_clocks, fit_times_and_clocks
from scanner.recordings.clocks import Clocks, find_loops
from tests.scanner.recordings.sampled_film import SIZE, FilmClocks, sample_film

NTSC = 60_000 / 1001
USUAL = FilmClocks(30.0, 1 / 60, 0.012, hold_s=0.1)


def fitted(clocks: FilmClocks) -> tuple[Clocks, float]:
    """The clocks, and by how many ppm the projector seems to be slower."""
    programme, samples = sample_film(clocks)
    fit = fit_clocks(samples, programme, find_loops(samples, programme).loops)
    return fit, 1e6 * (fit.loops[0].slot_s / programme.hold_s - 1)


@pytest.mark.parametrize(
    "clocks",
    [
        FilmClocks(NTSC, 0.010, 0.012, fast=9e-6),
        FilmClocks(NTSC, 0.010, -0.004, fast=-9e-6),
        FilmClocks(NTSC / 2, 0.005, 0.02, hold_s=0.1, fast=-9e-6),
        replace(USUAL, fast=0.001),
        replace(USUAL, rate=24.0, exposure_s=0.03),
        replace(USUAL, rate=240.0, exposure_s=1 / 480, readout_s=0.004, fast=0.001),
    ],
    ids=lambda clocks: f"{clocks.rate:.2f} {clocks.exposure_s} {clocks.readout_s}",
)
def test_the_clocks_of_a_film_that_lost_no_frame(clocks: FilmClocks) -> None:
    """Near 60 frames a second a change wraps once round the frame: half the exposure would fit all others."""
    fit, slower_ppm = fitted(clocks)
    assert fit.has_exposure
    assert fit.exposure_s == pytest.approx(clocks.exposure_s, rel=0.06, abs=2e-4)
    assert SIZE.height * fit.line_s == pytest.approx(clocks.readout_s, rel=0.06, abs=2e-4)
    assert slower_ppm == pytest.approx(-1e6 * clocks.fast, abs=40)
    assert not np.any(fit.shifts_s)


@pytest.mark.parametrize("clocks", [replace(USUAL, exposure_s=0.01), FilmClocks(NTSC, 0.01, 0.02, hold_s=0.1, loops=2)])
def test_pictures_that_a_player_showed_late_are_found(clocks: FilmClocks) -> None:
    fit, slower_ppm = fitted(replace(clocks, late=(24, 38)))
    assert fit.exposure_s == pytest.approx(clocks.exposure_s, rel=0.1)
    assert slower_ppm == pytest.approx(0, abs=60)
    shifts = fit.shifts_s[0]
    assert np.flatnonzero(shifts).tolist() == [24, 38]
    assert shifts[[24, 38]] == pytest.approx(1 / 60, abs=0.004)


def test_an_exposure_that_a_film_does_not_determine_is_a_range() -> None:
    """At the video's own rate all pictures change at one moment of the frames."""
    fit, _ = fitted(FilmClocks(60.0, 0.008, 0.004))
    least, greatest = fit.exposures_s
    assert not fit.has_exposure
    assert 0.0005 < least < 0.0065
    assert 0.0095 < greatest < 0.018


@pytest.mark.parametrize("dropped", [(), (30, 31, 60)])
def test_uneven_stamps_of_frames_that_came_evenly_are_no_times(dropped: tuple[int, ...]) -> None:
    clocks = FilmClocks(NTSC, 0.010, 0.012, fast=9e-6, uneven_stamps_s=0.004, dropped=dropped)
    programme, samples = sample_film(clocks)

    even, fit = fit_times_and_clocks(samples, programme, find_loops(samples, programme).loops)

    assert 1e-3 < np.abs(even.times_s - samples.times_s).max() < 5e-3
    assert np.diff(even.times_s).min() == pytest.approx(1 / NTSC, rel=1e-3)
    assert fit.has_exposure
    assert fit.exposure_s == pytest.approx(clocks.exposure_s, rel=0.06)
    assert SIZE.height * fit.line_s == pytest.approx(clocks.readout_s, rel=0.06)
    assert not np.any(fit.shifts_s)


def test_right_stamps_of_frames_that_came_unevenly_are_kept() -> None:
    programme, samples = sample_film(replace(USUAL, uneven_frames_s=0.004, uneven_stamps_s=0.004))

    kept, fit = fit_times_and_clocks(samples, programme, find_loops(samples, programme).loops)

    assert kept is samples
    assert fit.exposure_s == pytest.approx(USUAL.exposure_s, rel=0.03)


@pytest.mark.parametrize("clocks", [USUAL, FilmClocks(NTSC, 0.010, 0.012, fast=9e-6)])
@pytest.mark.parametrize("seed", [0, 1])
def test_an_exposure_is_open_where_frames_came_unevenly_and_no_stamp_says_so(clocks: FilmClocks, seed: int) -> None:
    programme, samples = sample_film(replace(clocks, uneven_frames_s=0.004), seed)

    _, fit = fit_times_and_clocks(samples, programme, find_loops(samples, programme).loops)

    assert not fit.has_exposure
    assert fit.exposures_s[0] < clocks.exposure_s < fit.exposures_s[1]
