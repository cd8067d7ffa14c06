"""Whether the projector shows single pixels unchanged: measured before a capture, and reported then and in replays."""

import pytest

from hw.open_rig import open_rig
from hw.settings import PanelSettings, SimulatedRigSettings
from scanner.capture import CHANGED_SHAPE, known_of_lines, measure_lines, remarks_on_lines, shows_single_pixels

CAMERA, PROJECTOR = (204, 160), (214, 120)


def measured(**settings: object) -> dict[str, object]:
    rig = SimulatedRigSettings.model_validate({"backend": "simulated", **settings})
    with open_rig(rig, CAMERA, PROJECTOR) as opened:
        (found,) = measure_lines(opened.rig)
    return dict(found)


@pytest.mark.parametrize(
    ("settings", "least", "most"),
    [
        ({}, 0.9, 1.1),
        ({"panel": {"mirrored": True}}, 0.9, 1.1),
        ({"ambient": 0.3, "camera_blur_px": 2.0, "projector_blur_px": 1.5}, 0.9, 1.1),
        ({"panel": PanelSettings(keystone=0.02)}, 0.2, 0.55),
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
    said = list(remarks_on_lines({"camera": "of one who recorded it", **found}))
    assert [sentence.startswith(CHANGED_SHAPE) for sentence in said] == [True] * (most < 0.6)
    assert shows_single_pixels(found) == (most > 1)
    assert known_of_lines({"frames": [], **found}) == found


@pytest.mark.parametrize(("camera", "projector"), [(CAMERA, PROJECTOR), ((612, 512), (854, 480))])
def test_relevant_keystone_correction_blurs_single_pixels(camera: tuple[int, int], projector: tuple[int, int]) -> None:
    """Keystone that moves the picture's corners by half a pixel."""
    rig = SimulatedRigSettings(panel=PanelSettings(keystone=1.0 / projector[0]))
    with open_rig(rig, camera, projector) as opened:
        (found,) = measure_lines(opened.rig)
    (kept,) = found.values()
    assert isinstance(kept, float)
    assert 0.4 < kept < 0.9
    assert not shows_single_pixels({"lines_of_one_pixel_keep": kept})


def test_a_projector_with_a_linear_response_gives_no_result() -> None:
    assert measured(gamma=1.0) == {}
    assert not list(remarks_on_lines({}))


def test_foreign_metadata_values_are_ignored() -> None:
    assert not list(remarks_on_lines({"lines_of_one_pixel_keep": "nothing"}))
    assert not shows_single_pixels({"lines_of_one_pixel_keep": "nothing"})
