"""Imperfections of real projectors, cameras and rooms, each within bands."""

from typing import Any

import numpy as np
import pytest

from calib.numerics import Floats
from hw.settings import PanelSettings, SimulatedRigSettings
from hw.simulated.picture import PictureOptics, responded
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.room import DrawnRoom, draw_room
from hw.simulated.simulation import SimulatedRoom, true_calibration

pytestmark = pytest.mark.xdist_group("simulated_room")

WHITE = np.full((120, 214), 255, np.uint8)
PICTURE = PictureOptics(40, 24, gamma=1.0, contrast=1e6, blur_px=0.0)


def frames(room: SimulatedRoom, count: int) -> Floats:
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    projector.show(WHITE)
    return np.stack([camera.grab().image.astype(float) for _ in range(count)])


def lit(room: SimulatedRoom) -> Floats:
    return room.renderer.direct(np.ones(WHITE.shape, np.float32)) > 0.2 * room.renderer.render(WHITE).max()


def stripes(width: int) -> np.ndarray:
    return np.broadcast_to(np.where(np.arange(40) // width % 2 == 0, 255, 0), (24, 40)).astype(np.uint8)


def test_flicker_has_the_configured_amplitude(room: SimulatedRoom) -> None:
    taken = frames(room.under(flicker=0.1, exposure_us=0.5 * room.sensor.exposure_us), 40)
    brightness = taken[:, lit(room)].mean(axis=1)
    relative = brightness / brightness.mean() - 1
    assert 0.07 < np.abs(relative).max() < 0.12
    assert np.std(relative) == pytest.approx(0.1 / np.sqrt(2), rel=0.3)
    # Nothing but the projector flickers.
    dark = taken[:, ~(room.renderer.direct(np.ones(WHITE.shape, np.float32)) > 0)].mean(axis=1)
    assert np.std(dark) / np.mean(dark) < 0.08


def test_a_rolling_shutter_shows_flicker_as_bands(room: SimulatedRoom) -> None:
    bands = room.under(flicker=0.15, rolling_shutter_ms=50.0, exposure_us=0.5 * room.sensor.exposure_us)
    steady = room.under(exposure_us=0.5 * room.sensor.exposure_us)
    ratio = frames(bands, 1)[0] / np.maximum(frames(steady, 20).mean(axis=0), 1)
    rows = np.array([np.median(row[mask]) for row, mask in zip(ratio, lit(room), strict=True) if mask.sum() > 20])
    assert 0.2 < np.ptp(rows) < 0.4  # three periods from top to bottom, 15 % to either side


@pytest.mark.parametrize(("width", "kept"), [(1, 0.6), (2, 0.8), (4, 0.9)])
def test_fine_stripes_lose_light(width: int, kept: float) -> None:
    crosstalk = PICTURE.under(SimulatedRigSettings(gamma=1.0, contrast=1e6, stripe_loss=0.4))
    light = crosstalk.linear(stripes(width))[:, 8:32]
    assert light.mean() / PICTURE.linear(stripes(width))[:, 8:32].mean() == pytest.approx(kept, abs=0.01)
    assert light.min() >= 0
    np.testing.assert_allclose(crosstalk.linear(np.full((24, 40), 255, np.uint8)), 1.0, rtol=1e-5)


def test_sharpening_steepens_edges_and_leaves_uniform_areas() -> None:
    ramp = np.broadcast_to(np.clip(40 * np.arange(40) - 700, 60, 180), (24, 40)).astype(np.uint8)
    plain, sharp = (PICTURE.under(SimulatedRigSettings(gamma=1.0, sharpening=s)).linear(ramp) for s in (0.0, 1.0))
    assert 0.01 < np.ptp(sharp) - np.ptp(plain) < 0.3
    np.testing.assert_allclose(sharp[:, :5], plain[:, :5], atol=1e-3)


@pytest.mark.parametrize(
    "panel", [{"scale": 0.8}, {"scale": 1.2, "squeeze": 0.75}, {"keystone": 0.2}, {"mirrored": True}]
)
def test_ground_truth_includes_the_panels_homography(room: SimulatedRoom, panel: Any) -> None:
    reshaped = room.under(panel=panel)
    truth = reshaped.ground_truth().projector_px
    x = np.broadcast_to(np.arange(214, dtype=np.uint8), (120, 214))
    linear = reshaped.renderer.picture.under(SimulatedRigSettings(gamma=1.0, contrast=1e6, panel=panel))
    ramp, white = (reshaped.renderer.direct(linear.linear(image)) for image in (x.copy(), WHITE))
    inner = (truth[..., 0] > 3) & (truth[..., 0] < 210) & (truth[..., 1] > 3) & (truth[..., 1] < 116)
    inner &= white > 0.2 * white.max()
    error = 255 * ramp[inner] / white[inner] - truth[inner][:, 0]
    assert inner.mean() > 0.05
    assert 0 < np.median(np.abs(error)) < 0.05


def test_enlarging_the_picture_changes_the_true_focal_length(room: SimulatedRoom) -> None:
    plain, enlarged = room.calibration, room.under(panel={"scale": 0.8, "squeeze": 0.75}).calibration
    assert enlarged.projector.focal_px[1] == pytest.approx(plain.projector.focal_px[1] / 0.8)
    assert enlarged.projector.focal_px[0] == pytest.approx(plain.projector.focal_px[0] / 0.6)
    truth = room.under(panel={"scale": 0.8, "squeeze": 0.75}).ground_truth()
    seen = np.isfinite(truth.projector_px[..., 0])
    there = enlarged.pose @ truth.points_m[seen]
    np.testing.assert_allclose(enlarged.projector.project(there), truth.projector_px[seen], atol=1e-6)


@pytest.mark.parametrize("panel", [PanelSettings(keystone=0.1), PanelSettings(mirrored=True)])
def test_a_picture_that_no_pinhole_explains_has_no_true_calibration(room: SimulatedRoom, panel: Any) -> None:
    assert room.under(panel=panel.model_dump()).calibration is None
    assert true_calibration(room.room) is not None


def test_ambient_light_is_switched_on_at_the_configured_frame(room: SimulatedRoom) -> None:
    switched = frames(room.under(light={"frame": 2, "ambient": 0.15}, exposure_us=0.5 * room.sensor.exposure_us), 4)
    before, at, after = switched[1] - switched[0], switched[2] - switched[1], switched[3] - switched[2]
    gained = 0.1 * np.median(room.renderer.direct(np.ones(WHITE.shape, np.float32))[lit(room)])
    expected = room.sensor.electrons(np.full((1, 1), gained, np.float32))[0, 0] * 0.5 * 255 / 10_500
    assert at[lit(room)].mean() == pytest.approx(expected, rel=0.35)
    assert max(abs(before.mean()), abs(after.mean())) < 0.1


def test_responses_rise_from_zero_to_one() -> None:
    light = np.linspace(0, 1, 101, dtype=np.float32)
    srgb, photo = responded(light, "srgb"), responded(light, "photo")
    np.testing.assert_array_equal(responded(light, "linear"), light)
    for curve in (srgb, photo):
        assert (curve[0], curve[-1]) == pytest.approx((0, 1), abs=1e-5)
        assert np.all(np.diff(curve) > 0)
    assert srgb[50] == pytest.approx(0.7354, abs=1e-3)  # IEC 61966-2-1
    assert srgb[10] > photo[10]
    assert srgb[60] < photo[60]


def test_a_person_passes_and_leaves(room: SimulatedRoom) -> None:
    taken = frames(room.under(passer={"width_m": 0.3, "first_frame": 1, "last_frame": 3}), 6)
    changed = [np.mean(np.abs(frame - taken[0])[lit(room)] > 25) for frame in taken]
    assert changed[0] == 0
    assert max(changed[4:]) < 0.01
    assert 0.1 < max(changed[1:4]) < 0.9


def test_a_rotated_cupboard_touches_its_wall() -> None:
    straight, askew = (draw_room(SimulatedRigSettings(seed=1, furniture_askew_deg=angle)) for angle in (0.0, 2.0))
    np.testing.assert_array_equal(straight.scene.blocks[0].edges, askew.scene.blocks[0].edges)

    def angle_deg(room: DrawnRoom) -> float:
        along = room.scene.blocks[3].edges[0]
        return float(np.degrees(np.arctan2(along[1], along[0])))

    assert angle_deg(straight) % 90 == 0
    assert 0.1 < abs(angle_deg(askew)) < 6
    edges = askew.scene.blocks[3]
    corners = edges.origin + np.array([a * edges.edges[0] + b * edges.edges[1] for a in (0, 1) for b in (0, 1)])
    assert np.min(corners[:, :2]) == pytest.approx(-0.004, abs=1e-9)
