"""Whether the projector shows single pixels unchanged: measured before a capture, and reported then and in replays."""

from functools import lru_cache

import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.capture import CHANGED_SHAPE, findings_on_lines, known_of_lines, measure_lines, shows_single_pixels
from tests.support.rig_bench import changed, rig_in

pytestmark = pytest.mark.xdist_group("single pixels")  # the rooms are made once
SIZES = ((204, 160), (214, 120)), ((408, 320), (428, 240))


@lru_cache
def room(camera: tuple[int, int], projector: tuple[int, int]) -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(furniture=False, interreflection=False), camera, projector)


def measured(sizes: tuple[tuple[int, int], tuple[int, int]] = SIZES[0], /, **settings: object) -> dict[str, object]:
    (found,) = measure_lines(rig_in(changed(room(*sizes), **settings)))
    return dict(found)


@pytest.mark.parametrize(
    ("settings", "least", "most"),
    [
        ({}, 0.9, 1.1),
        ({"panel": {"mirrored": True}}, 0.9, 1.1),
        ({"ambient": 0.3, "camera_blur_px": 2.0, "projector_blur_px": 1.5}, 0.9, 1.1),
        ({"panel": {"keystone": 0.02}}, 0.2, 0.55),
        ({"panel": {"keystone": 0.1}}, 0.2, 0.55),
        ({"panel": {"scale": 0.8}}, 0.2, 0.5),
    ],
)
def test_single_pixel_lines_survive_unless_the_picture_is_resampled(
    settings: dict[str, object], least: float, most: float
) -> None:
    found = measured(**settings)
    (kept,) = found.values()
    assert isinstance(kept, float)
    assert least < kept < most
    said = list(findings_on_lines({"camera": "of one who recorded it", **found}))
    assert [finding.kind for finding in said] == [CHANGED_SHAPE] * (most < 0.6)
    assert shows_single_pixels(found) == (most > 1)
    assert known_of_lines({"frames": [], **found}) == found


@pytest.mark.parametrize("sizes", SIZES)
def test_relevant_keystone_correction_blurs_single_pixels(sizes: tuple[tuple[int, int], tuple[int, int]]) -> None:
    """Keystone that moves the picture's corners by half a pixel."""
    (kept,) = measured(sizes, panel={"keystone": 1.0 / sizes[1][0]}).values()
    assert isinstance(kept, float)
    assert 0.4 < kept < 0.9
    assert not shows_single_pixels({"lines_of_one_pixel_keep": kept})


def test_a_projector_with_a_linear_response_gives_no_result() -> None:
    assert measured(gamma=1.0) == {}
    assert not list(findings_on_lines({}))


def test_foreign_metadata_values_are_ignored() -> None:
    assert not list(findings_on_lines({"lines_of_one_pixel_keep": "nothing"}))
    assert not shows_single_pixels({"lines_of_one_pixel_keep": "nothing"})
