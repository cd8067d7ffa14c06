"""Devices that move during a capture: frames show the views from the moved poses."""

import numpy as np
import pytest

from calib.numerics import Floats, Image
from hw.settings import PasserSettings, SimulatedRigSettings
from hw.simulated.motion import person_in, turned
from hw.simulated.renderer import Renderer
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.room import draw_room
from hw.simulated.simulation import SimulatedRoom

pytestmark = pytest.mark.xdist_group("simulated_room")

WHITE = np.full((120, 214), 255, np.uint8)


def ramps(renderer: Renderer) -> Floats:
    """The projector's coordinates that directly light each camera pixel, (H, W, 2), NaN in shadow."""
    x, y = np.meshgrid(np.arange(214, dtype=np.float32), np.arange(120, dtype=np.float32))
    white = renderer.direct(np.ones_like(x))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack([renderer.direct(ramp) / white for ramp in (x, y)], axis=-1)


@pytest.mark.parametrize("name", ["camera", "projector"])
@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 210.0])
def test_a_bump_moves_the_picture_by_the_configured_pixels(
    room: SimulatedRoom, name: str, direction_deg: float
) -> None:
    step = 0.5 * np.array([np.cos(np.radians(direction_deg)), np.sin(np.radians(direction_deg))])
    before = getattr(room.room, name)
    after = turned(before, step)
    on_axis = before.centre[:, None] + before.rays(np.array(before.optics.principal_point_px)[:, None])
    moved = after.project(on_axis)[0] - before.project(on_axis)[0]
    # The head of the tripod is not in the lens: a metre away the move is a little more or less than asked for.
    np.testing.assert_allclose(moved[:, 0], step, atol=0.12)
    np.testing.assert_allclose(after.rotation @ after.rotation.T, np.eye(3), atol=1e-12)
    assert 0 < np.linalg.norm(after.centre - before.centre) < 0.003


def test_the_fringes_move_after_the_bump_and_not_before(room: SimulatedRoom) -> None:
    bumped = room.under(bump={"device": "projector", "frame": 2, "px": 1.0})
    assert bumped.at(1) is bumped.renderer
    shift = ramps(bumped.at(2)) - ramps(room.renderer)
    inner = np.isfinite(shift).all(axis=-1) & (np.abs(shift) < 3).all(axis=-1)
    assert inner.mean() > 0.1
    assert np.median(shift[inner][:, 0]) == pytest.approx(1.0, abs=0.15)
    assert np.median(shift[inner][:, 1]) == pytest.approx(0.0, abs=0.15)
    assert bumped.at(2) is bumped.at(7)


def test_a_bumped_camera_sees_the_room_shifted(room: SimulatedRoom) -> None:
    bumped = room.under(bump={"device": "camera", "frame": 1, "px": 4.0})
    before, after = (bumped.at(frame).render(WHITE) for frame in (0, 1))
    unmoved, moved = (
        np.corrcoef(before[20:-20, 20:-20].ravel(), np.roll(after, -shift, axis=1)[20:-20, 20:-20].ravel())[0, 1]
        for shift in (0, 4)
    )
    assert unmoved < moved
    assert moved > 0.99


def test_a_drift_grows_from_frame_to_frame(room: SimulatedRoom) -> None:
    drifting = room.under(drift={"device": "projector", "px_per_frame": 0.1, "direction_deg": 90.0})
    assert drifting.at(0) is drifting.renderer
    shifts = [np.nanmedian((ramps(drifting.at(frame)) - ramps(room.renderer))[..., 1]) for frame in (5, 10)]
    np.testing.assert_allclose(shifts, [0.5, 1.0], atol=0.12)


def test_indirect_light_moves_with_the_projector(room: SimulatedRoom) -> None:
    """A rotated projector lights the room like one at rest that shows its picture rotated."""
    stripes = np.zeros((120, 214), np.float32)
    stripes[:, 80:110] = 1.0
    moved = room.under(bump={"px": 30.0}).at(0)
    shifted = np.roll(stripes, -30, axis=1)
    near, far = (
        np.abs(moved.indirect(stripes) - other).sum() / other.sum()
        for other in (room.renderer.indirect(shifted), room.renderer.indirect(stripes))
    )
    assert 0 < near < 0.4 * far


def frames(room: SimulatedRoom, *pictures: Image) -> list[Floats]:
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    taken = []
    for picture in pictures:
        projector.show(picture)
        taken.append(camera.grab().image.astype(float))
    return taken


def test_a_slow_panel_still_shows_a_share_of_the_last_picture(room: SimulatedRoom) -> None:
    black = np.zeros_like(WHITE)
    lit = room.renderer.direct(np.ones(WHITE.shape, np.float32)) > 0
    white, steady, dark = (image[lit].mean() for image in frames(room.under(ghost=0.3), WHITE, WHITE, black))
    without = frames(room, black)[0][lit].mean()
    assert white / steady == pytest.approx(0.7, abs=0.03)  # after black
    assert (dark - without) / (steady - without) == pytest.approx(0.3, abs=0.02)


def test_settings_of_the_room_require_a_new_room(room: SimulatedRoom) -> None:
    with pytest.raises(ValueError, match="seed, albedo"):
        room.under(seed=1, albedo=0.5)


@pytest.mark.parametrize("seed", [0, 3])
def test_a_person_crosses_the_picture_from_its_left_border_to_its_right_one(seed: int) -> None:
    camera = draw_room(SimulatedRigSettings(seed=seed)).camera
    passer = PasserSettings(width_m=0.5, first_frame=2, last_frame=11)
    assert person_in(1, passer, camera) is None
    assert person_in(12, passer, camera) is None
    at_px = list[float]()
    for frame in range(2, 12):
        person = person_in(frame, passer, camera)
        assert person is not None
        middle = person.origin + 0.5 * (person.edges[0] + person.edges[1])
        middle[2] = camera.centre[2]
        at_px.append(float(camera.project(middle[:, None])[0][0, 0]))
    ideal_px = camera.optics.width * (np.arange(10) + 0.5) / 10
    assert np.all(np.diff(at_px) > 0)
    assert np.abs(np.array(at_px) - ideal_px).max() < 0.2 * camera.optics.width  # the camera looks down, too
