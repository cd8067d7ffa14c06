"""Captures by others with real devices; the figures in their README come from an independent decoder."""

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calib.geometry import intersect
from calib.numerics import Image
from scanner.capture import open_capture
from scanner.decoding.decoder import Decoder, Decoding
from scanner.decoding.mask_reasons import MaskReason
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.patterns import Pattern
from tests.support.places import REAL_CAPTURES

DATA = REAL_CAPTURES
SHELL = "sltk-scan0020"
OBJECTS = ("phase-shifting-object1", "phase-shifting-object2")
pytestmark = [
    pytest.mark.skipif(not DATA.exists(), reason="the real captures in shared/data are not there"),
    pytest.mark.xdist_group("decoded real captures"),  # each is read once
]

Frames = tuple[tuple[Pattern, ...], tuple[Image, ...], tuple[int, int]]


@lru_cache
def read(name: str) -> Frames:
    stream = open_capture(DATA / name).stream()
    return stream.patterns, tuple(frame.image for _, frame in stream.frames), stream.projector_size


def decode(name: str, part: tuple[slice, slice] = np.s_[:, :], exchange: tuple[int, int] = (0, 0)) -> Decoding:
    patterns, images, projector_size = read(name)
    frames = list(images)
    i, j = exchange
    frames[i], frames[j] = frames[j], frames[i]
    decoder = Decoder(patterns, projector_size)
    for frame in frames:
        image: Any = np.ascontiguousarray(frame[part])
        decoder.add(image)
    return decoder.finish()


@lru_cache(maxsize=1)
def whole(name: str) -> Decoding:
    return decode(name)


def test_the_shell_is_decoded_as_well_as_by_an_independent_decoder() -> None:
    decoding = whole(SHELL)
    valid = np.count_nonzero(decoding.reasons == MaskReason.KEPT)
    assert 155_000 < valid < 165_000, "156,935 there"
    assert 103_000 < len(decoding.matches) < 108_000, "104,763 there"
    low, high = decoding.matches.projector_px.min(axis=0), decoding.matches.projector_px.max(axis=0)
    assert np.all(low >= 0)
    assert np.all(high <= (1279, 719))
    assert np.all(high >= (1270, 715))


def test_the_shell_lies_on_its_reference() -> None:
    calibration = read_calibration(DATA / SHELL / "calibration.yaml")
    matches = whole(SHELL).matches
    found = intersect(matches, calibration)
    assert 0.2 < np.median(np.abs(found.residual_px)) < 0.34, "0.32 there"
    assert np.mean(np.abs(found.residual_px) < 3) > 0.985
    assert np.all(found.in_front)
    distance, _ = cKDTree(found.points).query(reference())
    assert 0.001 < np.median(distance) < 0.02, "0.012 there"
    assert np.quantile(distance, 0.95) < 0.4, "0.38 there, the spacing of the reference"


def reference() -> NDArray[np.float64]:
    content = (DATA / SHELL / "reference.ply").read_bytes()
    body = content[content.index(b"end_header\n") + len(b"end_header\n") :]
    points = np.frombuffer(body, dtype=[("at", "<f4", 3), ("colour", "u1", 3)])["at"].astype(np.float64)
    return points * (1, -1, -1)


@pytest.mark.parametrize(("name", "residual_px"), [(OBJECTS[0], 1.35), (OBJECTS[1], 0.98)])
def test_the_objects_are_decoded_in_spite_of_their_gamma(name: str, residual_px: float) -> None:
    """The README's residuals have the response measured and inverted first; here it is not measured."""
    decoding = decode(name)
    assert 1_300_000 < len(decoding.matches) < 1_500_000
    distance = epipolar_distance_px(decoding)
    assert 0.3 < np.median(distance) < residual_px
    assert np.mean(distance > 20) < 0.01


def epipolar_distance_px(decoding: Decoding) -> NDArray[np.float64]:
    """Return the distances from the epipolar lines of the best fundamental matrix, in projector pixels."""
    camera, projector = decoding.matches.camera_px, decoding.matches.projector_px
    some = np.random.default_rng(0).choice(len(camera), 20_000, replace=False)
    matrix, _ = cv2.findFundamentalMat(camera[some], projector[some], cv2.USAC_MAGSAC, 3.0, 0.999, 10_000)
    lines = np.column_stack([camera, np.ones(len(camera))]) @ matrix.T
    along = np.abs(np.sum(lines[:, :2] * projector, axis=1) + lines[:, 2])
    return along / np.hypot(lines[:, 0], lines[:, 1])


@pytest.mark.parametrize(
    ("name", "part", "seed"),
    [
        (SHELL, np.s_[700:1100, 400:850], 1),
        (OBJECTS[0], np.s_[300:700, 600:1050], 2),
        (OBJECTS[1], np.s_[300:700, 500:950], 3),
    ],
    ids=[SHELL, *OBJECTS],
)
def test_exchanged_frames_are_named_or_do_no_harm(name: str, part: tuple[slice, slice], seed: int) -> None:
    right = decode(name, part)
    rng = np.random.default_rng(seed)
    for _ in range(4):
        i, j = (int(k) for k in rng.choice(len(read(name)[0]), 2, replace=False))
        try:
            found = decode(name, part, (i, j))
        except InputError as error:
            assert f"frame {i} " in str(error) or f"frame {j} " in str(error)  # noqa: PT017
            continue
        assert np.mean(distance_px(right, found) > 2) < 0.01


def distance_px(right: Decoding, found: Decoding) -> NDArray[np.float64]:
    """Return the distances of the matches that both have, by camera pixel."""
    both = []
    for decoding in (right, found):
        coordinates = np.full((*decoding.reasons.shape, 2), np.nan)
        column, row = np.rint(decoding.matches.camera_px).astype(int).T
        coordinates[row, column] = decoding.matches.projector_px
        both.append(coordinates)
    distance = np.abs(both[0] - both[1]).max(axis=2)
    return distance[np.isfinite(distance)]
