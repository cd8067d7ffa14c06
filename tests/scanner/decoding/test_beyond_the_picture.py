"""No match is beyond the borders of the projector's picture, whichever step carries a coordinate there."""

from dataclasses import dataclass, replace
from math import ceil, log2

import numpy as np
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st

from calib.numerics import Bools
from calib.refusal import RefusalError
from scanner.decoding.coordinates import CoordinateMap
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.matches import collect_matches
from scanner.decoding.planning import plan_sequence
from scanner.errors import InputError
from scanner.patterns import Axis, Black, Gray, Pattern, White, sequence_for
from tests.support.synthetic_capture import Light, Scene, Turned, decode


def centred(size: tuple[int, int], cell: int, *, inverses: bool) -> tuple[Pattern, ...]:
    """White, black and codes that are counted from the middle of the picture."""
    patterns: list[Pattern] = [White(), Black()]
    axes: tuple[Axis, ...] = ("x", "y")
    for axis, length in zip(axes, size, strict=True):
        bits = ceil(log2(length / cell))
        offset = ((cell << bits) - length) // 2
        signs = (False, True) if inverses else (False,)
        patterns += [Gray(axis, bit, bits, cell, offset, sign) for bit in range(bits) for sign in signs]
    return tuple(patterns)


def first_of_y(patterns: tuple[Pattern, ...]) -> int:
    return next(number for number, pattern in enumerate(patterns) if getattr(pattern, "axis", "") == "y")


@settings(max_examples=12, suppress_health_check=[HealthCheck.too_slow])
@given(
    cell=st.sampled_from([1, 2, 4]),
    is_centred=st.booleans(),
    inverses=st.booleans(),
    blur_px=st.floats(0.3, 2.5),
    zoom=st.floats(0.8, 1.6),
    turn_deg=st.floats(-20, 20),
    moved_px=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
)
def test_matches_of_codes_with_blurred_rims_are_inside(
    cell: int,
    is_centred: bool,
    inverses: bool,
    blur_px: float,
    zoom: float,
    turn_deg: float,
    moved_px: tuple[float, float],
) -> None:
    size = (72, 48)
    still = Turned((120, 90), size, camera_blur_px=blur_px, zoom=zoom, turn_deg=turn_deg, indirect=0.05)
    after = replace(still, right_px=moved_px[0], down_px=moved_px[1])
    patterns = (
        centred(size, cell, inverses=inverses)
        if is_centred
        else sequence_for(size, cell=cell, shifts=0, inverses=inverses)
    )
    bumped = first_of_y(patterns)
    frames = [(after if number >= bumped else still).frame(pattern, number) for number, pattern in enumerate(patterns)]
    try:
        projector_px = decode(patterns, frames, size).matches.projector_px
    except (InputError, RefusalError):
        reject()
    assert np.all((projector_px >= -1) & (projector_px <= size))


@dataclass(frozen=True)
class Occluded(Turned):
    """A box at the picture's upper border that hides the wall, and is lit from 60 rows further down."""

    def box(self, u: Light, v: Light) -> tuple[Light, Light]:
        x, y = super().box(u, v)
        return x, y + 60

    def is_box(self, u: Light, v: Light) -> Bools:
        width, height = self.camera
        return (np.abs(u - 0.42 * width) < 0.2 * width) & (np.abs(v - 0.18 * height) < 0.14 * height)

    def is_shadow(self, u: Light, v: Light) -> Bools:
        return np.zeros(np.broadcast(u, v).shape, np.bool_)


@pytest.mark.parametrize(("zoom", "down_px"), [(1.1, 0.2), (1.3, -0.2)])
def test_a_motion_is_taken_back_from_whole_cells_even_beside_an_occlusion_at_the_border(
    zoom: float, down_px: float
) -> None:
    """There the coordinate changes by 60 px from pixel to pixel, and a fifth of that leads beyond the first row."""
    size = (300, 200)
    still = Occluded((192, 144), size, zoom=zoom, camera_blur_px=1.6, indirect=0.05)
    after = replace(still, right_px=down_px, down_px=down_px)
    patterns = sequence_for(size, cell=1, shifts=0)
    bumped = first_of_y(patterns)
    decoding = decode(
        patterns,
        [(after if number >= bumped else still).frame(pattern, number) for number, pattern in enumerate(patterns)],
        size,
    )
    projector_px, outside = decoding.matches.projector_px, decoding.reasons == MaskReason.OUTSIDE
    assert decoding.motion is not None
    assert decoding.motion.is_significant
    assert 8000 < len(projector_px) < np.count_nonzero(decoding.reasons == MaskReason.KEPT), "one match for a cell"
    assert 1 <= np.count_nonzero(outside) < 200
    assert np.all((projector_px >= -1) & (projector_px <= size))
    moved_px = 1.4 * abs(down_px)
    assert np.abs(np.median(still.errors(decoding), axis=0)).max() < 0.4 * moved_px, (
        "rounded to cells, nothing is undone"
    )


@pytest.mark.parametrize("by_cell", [False, True])
@pytest.mark.parametrize(
    ("axis", "beyond_px", "reason"),
    [
        (0, -2.1, MaskReason.OUTSIDE),
        (0, 65.2, MaskReason.OUTSIDE),
        (1, -1.2, MaskReason.OUTSIDE),
        (1, 49.0, MaskReason.OUTSIDE),
        (0, -0.8, MaskReason.KEPT),
        (1, 47.9, MaskReason.KEPT),
    ],
)
def test_a_coordinate_beyond_any_border_is_outside(
    by_cell: bool, axis: int, beyond_px: float, reason: MaskReason
) -> None:
    size = Scene(projector=(64, 48)).projector
    plan = plan_sequence(sequence_for(size, cell=1, shifts=0), size)
    cell_px = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).astype(np.float32)
    projector_px = cell_px.copy()
    projector_px[20:22, 30:32, axis] = beyond_px
    shape = cell_px.shape[:2]
    maps = CoordinateMap(
        projector_px, np.full(shape, 0.1, np.float32), np.zeros(shape, np.uint8), np.zeros((2, 10), np.int64)
    )
    matches, reasons = collect_matches(plan, maps, cell_px if by_cell else None, np.full(shape, 200, np.uint8), None)
    assert np.all(reasons[20:22, 30:32] == reason)
    assert np.count_nonzero(reasons) == (0 if reason == MaskReason.KEPT else 4)
    assert len(matches) == np.count_nonzero(reasons == MaskReason.KEPT)
