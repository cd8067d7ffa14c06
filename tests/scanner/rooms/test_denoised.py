"""Noise is reduced, relief is kept."""

from dataclasses import replace

import numpy as np

from scanner.rooms.mesh import denoised
from tests.scanner.rooms.conftest import SolvedExample


def test_denoising_brings_points_closer_to_their_planes(example: SolvedExample) -> None:
    for station, true in zip(example.solved.stations, example.true, strict=True):
        raw, smooth = (
            points.reshape(-1, 3)[true.pixel] for points in (station.cloud.points, denoised(example.solved, station))
        )
        there = np.isfinite(raw[:, 2]) & (station.plane.reshape(-1)[true.pixel] >= 0)
        before, after = (np.linalg.norm((points - true.points)[there], axis=1) for points in (raw, smooth))
        assert 0.05 < np.median(after) / np.median(before) < 0.7
        assert np.percentile(after, 95) < np.percentile(before, 95)
        elsewhere = np.isfinite(raw[:, 2]) & ~there
        assert np.array_equal(raw[elsewhere], smooth[elsewhere])


def test_denoising_keeps_a_step(example: SolvedExample) -> None:
    station = example.solved.stations[0]
    plane = int(np.bincount(station.plane[station.plane >= 0]).argmax())
    on = (station.plane == plane) & station.cloud.there
    column = np.arange(on.shape[1])[None, :]
    nearer = on & (column < np.median(np.flatnonzero(on.any(axis=0))))
    points = station.cloud.points.copy()
    points[nearer] *= 0.97
    stepped = replace(station, cloud=replace(station.cloud, points=points))
    plain, kept = (denoised(example.solved, each)[..., 2] for each in (station, stepped))
    ratio = (kept / plain)[nearer]
    assert np.percentile(np.abs(ratio - 0.97), 98) < 0.003
    assert np.percentile(np.abs((kept / plain)[on & ~nearer] - 1), 98) < 0.003
