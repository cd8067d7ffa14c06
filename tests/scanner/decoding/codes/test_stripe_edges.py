"""Sub-pixel stripe edges, in frames of a plane with an exactly known map to the projector."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.numerics import Floats, Image
from scanner.decoding import Decoder, Decoding
from scanner.decoding.codes.edge_interpolation import edge_between
from scanner.patterns import Pattern, draw, sequence_for

PROJECTOR = (64, 48)
SHAPE = (72, 96)
_FINE = 6


@dataclass(frozen=True)
class PlanarScene:
    """x = `x` · (column, row, 1), and y likewise; `blur_px`: standard deviation of the lens blur, in camera pixels.

    `curve`: exponent of the camera's response. `shading`: relative brightness increase per camera pixel to the right.
    """

    x: tuple[float, float, float]
    y: tuple[float, float, float]
    blur_px: float = 0.4
    noise: float = 0.0
    curve: float = 1.0
    shading: float = 0.0

    def coordinates(self, column: Floats, row: Floats) -> Floats:
        return np.stack([a * column + b * row + c for a, b, c in (self.x, self.y)], axis=-1)

    def frame(self, pattern: Pattern, number: int) -> Image:
        """Render the camera's frame: each pixel averages a square of points and a Gaussian around them."""
        height, width = SHAPE
        rows, columns = ((np.arange(size * _FINE) + 0.5) / _FINE - 0.5 for size in (height, width))
        column, row = np.meshgrid(columns, rows)
        px = np.rint(self.coordinates(column, row)).astype(int)
        inside = np.all((px >= 0) & (px < PROJECTOR), axis=-1)
        shown = draw(pattern, PROJECTOR).astype(float)[
            px[..., 1].clip(0, PROJECTOR[1] - 1), px[..., 0].clip(0, PROJECTOR[0] - 1)
        ]
        light = (shown / 255 * inside + 0.03) * np.exp(self.shading * (column - width / 2))
        light = cv2.GaussianBlur(light, (0, 0), self.blur_px * _FINE)
        level = 200 * light.reshape(height, _FINE, width, _FINE).mean(axis=(1, 3)).clip(0, 1.25) ** self.curve
        level += self.noise * np.random.default_rng(number).standard_normal(level.shape)
        return np.rint(level.clip(0, 255)).astype(np.uint8)

    def decode(self, patterns: tuple[Pattern, ...]) -> Decoding:
        decoder = Decoder(patterns, PROJECTOR)
        for number, pattern in enumerate(patterns):
            decoder.add(self.frame(pattern, number))
        return decoder.finish()

    def errors(self, decoding: Decoding) -> Floats:
        """Return the errors (N, 2) of the matches at least four pixels from the picture's border."""
        px = self.coordinates(*np.asarray(decoding.matches.camera_px, np.float64).T)
        inner = np.all((px > 4) & (px < np.array(PROJECTOR) - 5), axis=1)
        return (decoding.matches.projector_px - px)[inner]


CODE = sequence_for(PROJECTOR, cell=1, shifts=0)
ASKEW = (0.61, 0.05, 3.2), (-0.04, 0.63, 2.1)


@pytest.mark.parametrize(
    ("plane", "patterns", "rms_px"),
    [
        (PlanarScene(*ASKEW), CODE, (0.002, 0.03)),
        (PlanarScene(*ASKEW, noise=1.5), CODE, (0.01, 0.05)),
        (PlanarScene(*ASKEW, curve=0.5), CODE, (0.002, 0.03)),
        (PlanarScene(*ASKEW, shading=0.015), CODE, (0.002, 0.03)),
        (PlanarScene(*ASKEW, blur_px=0.8), CODE, (0.002, 0.03)),
        (PlanarScene(*ASKEW), sequence_for(PROJECTOR, cell=1, shifts=0, inverses=False), (0.002, 0.06)),
        (PlanarScene(*ASKEW), sequence_for(PROJECTOR, cell=4, shifts=0), (0.002, 0.03)),
    ],
    ids=["sharp", "noise", "a bent curve", "shading", "blur", "without inverses", "cells of 4"],
)
def test_coordinates_between_edges_match_the_plane(
    plane: PlanarScene, patterns: tuple[Pattern, ...], rms_px: tuple[float, float]
) -> None:
    errors = plane.errors(plane.decode(patterns))
    assert len(errors) > 2500
    assert rms_px[0] < np.sqrt(np.mean(errors**2)) < rms_px[1], "a cell over the root of 12: 0.29"
    assert np.abs(errors.mean(axis=0)).max() < 0.01


@settings(max_examples=8)
@given(scale=st.floats(0.25, 0.9), turn_deg=st.floats(-180, 180), skew=st.floats(-0.3, 0.3))
def test_at_any_magnification_and_turn(scale: float, turn_deg: float, skew: float) -> None:
    turn = np.radians(turn_deg)
    across, down = scale * np.array([np.cos(turn), np.sin(turn)]), scale * np.array([-np.sin(turn), np.cos(turn)])
    down += skew * across
    middle = (np.array(PROJECTOR) - 1) / 2 - 47.5 * np.stack([across, down], axis=1)[:, 0]
    middle -= 35.5 * np.stack([across, down], axis=1)[:, 1]
    plane = PlanarScene((across[0], down[0], middle[0]), (across[1], down[1], middle[1]), noise=0.7)
    decoding = plane.decode(CODE)
    errors = plane.errors(decoding)
    assert len(errors) > 400
    assert np.sqrt(np.mean(errors**2)) < 0.1
    assert decoding.matches.sigma_px is not None
    assert 0.001 < np.median(decoding.matches.sigma_px) < 0.1


def test_an_edge_is_where_pattern_and_inverse_cross() -> None:
    place, contrast = edge_between((80.0, 40.0), (40.0, 80.0), -1)
    assert place == pytest.approx(0.5)
    assert contrast == 40
    place, contrast = edge_between((90.0, 60.0), (50.0, 60.0), 1)
    assert place == pytest.approx(0.75), "where the frame crosses its threshold"
    assert contrast == 40, "twice the difference from the threshold"


def test_an_albedo_step_moves_no_edge() -> None:
    # The same stripe, on a surface that reflects a third from the second pixel on.
    place, _ = edge_between((150.0, 60.0), (20.0, 50.0), -1)
    assert place == pytest.approx(0.5)
