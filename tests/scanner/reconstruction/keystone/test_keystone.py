"""Keystone correction, measured from the contrast of resampled stripes, which OpenCV draws here."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.geometry import Matches, mapped
from hw.open_rig import open_rig
from hw.settings import SimulatedRigSettings
from scanner.decoding import FinestStripes
from scanner.io import MATCHES_FILE, read_calibration, read_matches
from scanner.reconstruction.keystone.beat import planes_at
from scanner.reconstruction.keystone.measure import Keystone, beginning_as, measure_keystone
from scanner.results import CALIBRATION_FILE, read_verdict
from tests.support.command_line import run
from tests.support.findings import the_only

SIZE = (480, 270)
SHIFTS = 4


@given(st.integers(0, 2**32 - 1))
def test_pixels_get_the_plane_of_the_matches_around_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera_px = np.stack(np.meshgrid(np.arange(24), np.arange(16)), axis=-1).reshape(-1, 2).astype(np.float64)
    plane = np.where(camera_px[:, 0] < 12, 3, rng.integers(0, 2))
    pixels = rng.integers(0, (24, 16), (5, 2)).astype(np.float64)
    there = rng.random(len(plane)) < 0.9
    found = planes_at(pixels, camera_px[there], plane[there])
    for (column, row), said in zip(pixels, found, strict=True):
        near = there & (np.abs(camera_px - (column, row)).max(axis=1) <= 2)
        among = np.unique(plane[near])
        assert said == (among[0] if len(among) == 1 else -1)


def trapezoid(narrower: float, edge: str, inset: float) -> np.ndarray:
    """Homography from the picture's to the panel's pixels: one edge narrower by a share, and an inset on all sides."""
    width, height = SIZE
    corners = np.array([(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)], np.float32)
    x, y = narrower / 2 * width, narrower / 2 * height
    by = {
        "top": [(x, y), (-x, y), (0, 0), (0, 0)],
        "bottom": [(0, 0), (0, 0), (-x, -y), (x, -y)],
        "left": [(x, y), (0, 0), (0, 0), (x, -y)],
        "right": [(0, 0), (-x, y), (-x, -y), (0, 0)],
    }[edge]
    middle = (np.array(SIZE) - 1) / 2
    there = (corners + np.array(by, np.float32) - middle) * (1 - inset) + middle
    return cv2.getPerspectiveTransform(corners, there.astype(np.float32)).astype(np.float64)


def stripes(homography: np.ndarray, period: float, noise: float, seed: int) -> FinestStripes:
    """Remaining contrast of fringes on a panel that interpolates linearly, at random pixels."""
    width, height = SIZE
    rng = np.random.default_rng(seed)
    picture_px = rng.uniform((2, 2), (width - 3, height - 3), (6000, 2))
    panel_px = mapped(homography, picture_px).astype(np.float32)
    contrasts = []
    for axis in (0, 1):
        along = np.indices((height, width))[1 - axis]
        parts: list[np.ndarray] = []
        for shift in range(SHIFTS):
            picture = (0.5 + 0.5 * np.cos(2 * np.pi * (along / period + shift / SHIFTS))).astype(np.float32)
            panel = cv2.warpPerspective(picture, homography, SIZE, flags=cv2.INTER_LINEAR)
            blurred = cv2.GaussianBlur(panel, (0, 0), 0.7)
            parts.append(
                np.asarray(cv2.remap(blurred, panel_px[:, None, 0], panel_px[:, None, 1], cv2.INTER_CUBIC))[:, 0]
            )
        contrasts.append(np.hypot(parts[0] - parts[2], parts[1] - parts[3]))
    ratio = np.log(contrasts[0]) - np.log(contrasts[1]) + rng.normal(0, noise, len(picture_px))
    # A scene of two planes, one of which blurs stripes along y more than the other, and more and more.
    right = picture_px[:, 0] > width / 2
    ratio += np.where(right, 0.1, -0.2 + 1e-3 * picture_px[:, 1])
    return FinestStripes(np.rint(picture_px), picture_px, ratio, (period, period))


def measured(homography: np.ndarray, period: float = 6.7, noise: float = 0.05, seed: int = 0) -> Keystone | None:
    seen = stripes(homography, period, noise, seed)
    plane = (seen.projector_px[:, 0] > SIZE[0] / 2).astype(np.int32)
    return measure_keystone(seen, Matches(seen.camera_px, seen.projector_px), plane, SIZE)


def worst_px(found: np.ndarray, true: np.ndarray) -> float:
    """Largest error over the picture, apart from the origin of the panel."""
    grid = np.stack(np.meshgrid(np.linspace(0, SIZE[0] - 1, 9), np.linspace(0, SIZE[1] - 1, 9)), axis=-1).reshape(-1, 2)
    off = mapped(found, grid) - mapped(true, grid)
    return float(np.linalg.norm(off - np.rint(np.median(off, axis=0)), axis=1).max())


@settings(max_examples=4)
@given(
    st.floats(0.012, 0.04),
    st.sampled_from(["top", "bottom", "left", "right"]),
    st.floats(0.0, 0.01),
    st.sampled_from([4.0, 6.7, 8.43]),
    st.integers(0, 1000),
)
def test_a_trapezoid_is_found_to_sub_pixel_accuracy(
    narrower: float, edge: str, inset: float, period: float, seed: int
) -> None:
    true = trapezoid(narrower, edge, inset)
    keystone = measured(true, period, seed=seed)
    assert keystone is not None
    assert 0.9 * narrower < keystone.narrower < 1.1 * narrower
    off_px = worst_px(keystone.homography, true)
    assert off_px < 0.4
    # What it says that it may err by is of the size of what it errs by.
    grid = mapped(keystone.homography, np.array([(0.0, 0.0), (479.0, 0.0), (479.0, 269.0), (0.0, 269.0)]))
    fields = [np.linalg.norm(shift(grid, grid, grid), axis=1) for shift in keystone.shifts]
    sigma_px = float(np.sqrt(np.sum(np.square(fields), axis=0)).max())
    assert 0.005 < sigma_px < 0.25
    assert off_px < 5 * sigma_px


@pytest.mark.parametrize("seed", range(2))
def test_any_quadrangle_is_found(seed: int) -> None:
    """As if corners are moved one by one, or the projector is oblique."""
    rng = np.random.default_rng(seed)
    width, height = SIZE
    corners = np.array([(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)], np.float32)
    there = corners + np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * rng.uniform(0, 0.03, (4, 2)) * SIZE
    true = cv2.getPerspectiveTransform(corners, there.astype(np.float32)).astype(np.float64)
    keystone = measured(true, seed=seed)
    assert keystone is not None
    assert 1e-4 < worst_px(keystone.homography, true) < 0.2


@pytest.mark.parametrize(("scale", "period"), [(1.0, 6.7), (0.97, 4.0), (0.97, 12.3), (0.8, 6.7)])
def test_unscaled_and_reduced_pictures_have_no_keystone(scale: float, period: float) -> None:
    middle = (np.array(SIZE) - 1) / 2
    smaller = np.array([[scale, 0, middle[0] * (1 - scale)], [0, scale, middle[1] * (1 - scale)], [0, 0, 1.0]])
    assert measured(smaller, period) is None


def test_wide_stripes_give_no_result() -> None:
    assert measured(trapezoid(0.03, "top", 0.0), period=40.0, noise=0.0) is None


def test_noise_is_no_keystone() -> None:
    assert measured(trapezoid(0.03, "top", 0.0), noise=3.0) is None


def test_matches_off_any_plane_give_no_result() -> None:
    seen = stripes(trapezoid(0.03, "top", 0.0), 6.7, 0.05, 0)
    matches = Matches(seen.camera_px, seen.projector_px)
    assert measure_keystone(seen, matches, np.full(len(matches), -1, np.int32), SIZE) is None
    assert measure_keystone(seen, matches[:0], np.empty(0, np.int32), SIZE) is None


@given(st.integers(-9, 9), st.integers(-9, 9), st.floats(-0.4, 0.4))
def test_captures_of_one_rig_start_at_the_same_panel_pixel(right: int, down: int, by: float) -> None:
    one = trapezoid(0.03, "left", 0.0)
    other = np.array([[1, 0, right + by], [0, 1, down], [0, 0, 1]]) @ trapezoid(0.03, "left", 0.0)
    assert worst_from(beginning_as(one, other, SIZE), one) == pytest.approx(abs(by), abs=1e-6)


def worst_from(found: np.ndarray, true: np.ndarray) -> float:
    corners = np.array([(0.0, 0.0), (479.0, 0.0), (479.0, 269.0), (0.0, 269.0)])
    return float(np.linalg.norm(mapped(found, corners) - mapped(true, corners), axis=1).max())


def test_keystone_correction_is_undone_before_calibration(tmp_path: Path) -> None:
    """If ignored, the error would be 45 %, with a sigma of 1.5 %."""
    plain = {"furniture": False, "interreflection": False, "ambient": 0}
    settings = {
        "rig": {"backend": "simulated", "seed": 0, **plain, "panel": {"keystone": 0.02}},
        "camera": {"width": 612, "height": 512, "principal_point": {"known": [313.82, 263.32]}},
        "projector": {"width": 427, "height": 240},
        "corner": {"squareness_deg": 0},
    }
    (tmp_path / "room.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    assert run("--config", tmp_path / "room.yaml", "--out", tmp_path / "scan", "--quiet") == 0
    found = read_calibration(tmp_path / "scan" / CALIBRATION_FILE)
    verdict = read_verdict(tmp_path / "scan" / CALIBRATION_FILE)
    assert verdict is not None
    measured = the_only("keystone-corrected", verdict.findings)
    assert "2.0 % narrower" in measured.message
    assert 0.019 < measured.number("narrower_share") < 0.021
    with open_rig(SimulatedRigSettings.model_validate({"seed": 0} | plain), (612, 512), (427, 240)) as as_it_is:
        assert as_it_is.truth is not None
        true = as_it_is.truth.camera.focal_px[0]
    sigma = found.sigma.camera.focal_px
    assert sigma is not None
    assert 0.002 < sigma[0] / true < 0.05
    assert abs(found.camera.focal_px[0] - true) < 4 * sigma[0]
    # The panel's pixels, of which the picture has lost the upper corners.
    panel_px = read_matches(tmp_path / "scan" / MATCHES_FILE).projector_px
    upper = panel_px[panel_px[:, 1] < 20]
    assert 2 < upper[:, 0].min() < 8
