"""The whole rig in one small room: frames compared with ground truth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from calib.geometry import Intrinsics
from calib.numerics import Bools, Floats
from hw.open_rig import open_rig
from hw.settings import SimulatedRigSettings
from hw.simulated.device import Optics
from hw.simulated.picture import PictureOptics, build_sensor
from hw.simulated.placement import resized
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.room import _corner
from hw.simulated.scene import Label
from hw.simulated.simulation import GroundTruth, SimulatedRoom

pytestmark = pytest.mark.xdist_group("simulated_room")
BARREL = Optics(612, 512, 447.8, (314.0, 263.6), k1=-0.05, k2=0.008)
PICTURE = PictureOptics(40, 24, gamma=2.2, contrast=1000.0, blur_px=0.5)


@pytest.fixture(scope="module")
def truth(room: SimulatedRoom) -> GroundTruth:
    return room.ground_truth()


def uniform(room: SimulatedRoom, level: int) -> np.ndarray:
    optics = room.room.projector.optics
    return np.full((optics.height, optics.width), level, np.uint8)


def ramp(room: SimulatedRoom, axis: int) -> np.ndarray:
    """Light equal to the projector's coordinate."""
    optics = room.room.projector.optics
    x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
    return (x, y)[axis].astype(np.float32)


def shrunk(mask: Bools) -> Bools:
    """The mask eroded by one pixel."""
    inner = mask.copy()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            inner &= np.roll(mask, (dy, dx), axis=(0, 1))
    return inner


def plane_normal(points: Floats) -> Floats:
    normal: Floats = np.linalg.svd(points - points.mean(axis=0))[2][2]
    return normal


def test_true_points_project_to_true_pixels(room: SimulatedRoom, truth: GroundTruth) -> None:
    calibration = room.calibration
    x, y = np.meshgrid(np.arange(306.0), np.arange(256.0))
    np.testing.assert_allclose(calibration.camera.project(truth.points_m), np.stack([x, y], axis=-1), atol=1e-5)
    lit = np.isfinite(truth.projector_px[..., 0])
    assert 0.1 < lit.mean() < 0.3
    in_projector = calibration.pose @ truth.points_m[lit]
    np.testing.assert_allclose(calibration.projector.project(in_projector), truth.projector_px[lit], atol=1e-6)


def test_true_faces_are_planes_at_right_angles(truth: GroundTruth) -> None:
    normals = [plane_normal(truth.points_m[truth.label == label][::7]) for label in range(3)]
    np.testing.assert_allclose(np.abs(np.array(normals) @ np.array(normals).T), np.eye(3), atol=1e-7)


def test_the_true_sphere_has_its_radius(truth: GroundTruth) -> None:
    points = truth.points_m[truth.label == Label.SPHERE]
    design = np.column_stack([2 * points, np.ones(len(points))])
    *centre, constant = np.linalg.lstsq(design, np.sum(points**2, axis=1), rcond=None)[0]
    assert np.sqrt(constant + np.dot(centre, centre)) == pytest.approx(0.12, abs=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
def test_direct_light_comes_from_the_true_projector_pixel(room: SimulatedRoom, truth: GroundTruth, axis: int) -> None:
    light = ramp(room, axis)
    white = room.renderer.direct(np.ones_like(light))
    inner = shrunk(np.isfinite(truth.projector_px[..., 0]) & (white > 0)) & shrunk(
        np.isin(truth.projector_px[..., axis].round(), np.arange(3, light.max() - 3))
    )
    error = np.abs(room.renderer.direct(light)[inner] / white[inner] - truth.projector_px[inner][:, axis])
    assert 1e-5 < np.median(error) < 0.01
    assert 1e-4 < np.percentile(error, 95) < 0.1


def test_pixels_in_shadow_or_outside_the_picture_get_no_direct_light(room: SimulatedRoom, truth: GroundTruth) -> None:
    white = room.renderer.direct(np.ones((120, 214), np.float32))
    dark = np.isnan(truth.projector_px[..., 0])
    # Light spills over the picture's edge by blur: two pixels further in all is black.
    assert not white[shrunk(shrunk(shrunk(shrunk(dark))))].any()
    assert np.all(white[shrunk(~dark)] > 0)
    shadow = shrunk(shrunk(dark)) & (truth.label == Label.FLOOR)
    assert np.all(truth.direct_share[shadow] < 0.5)


def test_light_is_linear_in_the_projectors_light(room: SimulatedRoom) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.random((2, 120, 214), dtype=np.float32)
    for part in (room.renderer.direct, room.renderer.indirect):
        both, apart = part(2 * a + b), 2 * part(a) + part(b)
        assert both.max() > 0
        np.testing.assert_allclose(both, apart, rtol=1e-4, atol=1e-5 * both.max())


def test_the_projector_adds_gamma_and_a_black_level(room: SimulatedRoom) -> None:
    renderer = room.renderer
    white, grey, black = (renderer.render(uniform(room, level)) - renderer.ambient for level in (255, 128, 0))
    lit = white > 0.5 * np.median(white[white > 0])
    np.testing.assert_allclose(black[lit] / white[lit], 1e-3, rtol=1e-2)
    np.testing.assert_allclose(grey[lit] / white[lit], 1e-3 + 0.999 * (128 / 255) ** 2.2, rtol=1e-3)


def test_interreflection_is_strongest_near_the_creases(room: SimulatedRoom, truth: GroundTruth) -> None:
    lit = shrunk(np.isfinite(truth.projector_px[..., 0])) & (truth.label < 3)
    in_world = truth.points_m @ room.room.camera.rotation + room.room.camera.centre
    from_crease = np.sort(np.abs(in_world), axis=-1)[..., 1]
    near, far = (truth.direct_share[lit & zone].mean() for zone in (from_crease < 0.05, from_crease > 0.4))
    assert 0.4 < near < far - 0.1
    assert far < 0.95


def test_noise_is_shot_noise(room: SimulatedRoom) -> None:
    projector = SimulatedProjector(room)
    projector.show(uniform(room, 200))
    camera = SimulatedCamera(room, projector)
    frames = np.stack([camera.grab().image for _ in range(60)]).astype(float)
    mean, variance = frames.mean(axis=0), frames.var(axis=0, ddof=1)
    usable = (mean > 6) & (mean < 240)
    slope, offset = np.polyfit(mean[usable], variance[usable], 1)
    digits_per_electron = 255 / 10_500
    assert slope == pytest.approx(digits_per_electron, rel=0.05)
    # Read noise and rounding to whole digits, which adds 1/12.
    assert offset == pytest.approx((2.5 * digits_per_electron) ** 2 + 1 / 12, abs=0.03)


def test_noise_differs_between_frames_and_repeats_for_a_seed(room: SimulatedRoom) -> None:
    def two_frames() -> list[np.ndarray]:
        projector = SimulatedProjector(room)
        camera = SimulatedCamera(room, projector)
        projector.show(uniform(room, 100))
        return [camera.grab().image, camera.grab().image]

    (first, second), (first_again, second_again) = two_frames(), two_frames()
    assert np.any(first != second)
    np.testing.assert_array_equal(first, first_again)
    np.testing.assert_array_equal(second, second_again)


def test_a_room_is_the_same_for_the_same_seed(room: SimulatedRoom) -> None:
    _corner.cache_clear()
    again = SimulatedRoom(SimulatedRigSettings(seed=0), (306, 256), (214, 120))
    white = uniform(room, 255)
    np.testing.assert_allclose(again.renderer.render(white), room.renderer.render(white), rtol=1e-5)


def test_without_interreflection_and_ambient_light_only_direct_light_is_there(room: SimulatedRoom) -> None:
    dark = SimulatedRoom(SimulatedRigSettings(seed=0, interreflection=False, ambient=0), (306, 256), (214, 120))
    white = uniform(room, 255)
    direct = room.renderer.direct(room.renderer.picture.linear(white))
    np.testing.assert_array_equal(dark.renderer.render(white), direct)
    with pytest.raises(ValueError, match="ambient: another value needs another room"):
        dark.under(ambient=0.01)


def test_white_is_exposed_to_85_percent(room: SimulatedRoom) -> None:
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    assert np.percentile(camera.grab().image, 99.5) < 40  # before anything is shown
    projector.show(uniform(room, 255))
    frame = camera.grab()
    assert np.percentile(frame.image, 99.5) == pytest.approx(0.85 * 255, abs=4)
    assert frame.exposure_us == room.sensor.exposure_us


def test_longer_exposures_saturate_and_more_bits_resolve_more(room: SimulatedRoom) -> None:
    white = room.renderer.render(uniform(room, 255))
    rng = np.random.default_rng(0)
    long = build_sensor(SimulatedRigSettings(exposure_us=5 * room.sensor.exposure_us), white)
    image = long.read(long.electrons(white), rng)
    assert 0.05 < np.mean(image == 255) < 0.5
    fine = build_sensor(SimulatedRigSettings(bit_depth=12), white)
    image = fine.read(fine.electrons(white), rng)
    assert image.dtype == np.uint16
    assert np.percentile(image, 99.5) == pytest.approx(0.85 * 4095, rel=0.02)


def test_the_camera_lens_blurs(room: SimulatedRoom) -> None:
    white = room.renderer.render(uniform(room, 255))
    sharp, soft = (
        build_sensor(SimulatedRigSettings(camera_blur_px=blur, exposure_us=1e4), white).electrons(white)
        for blur in (0.0, 1.5)
    )
    assert np.abs(np.diff(soft, axis=1)).max() < 0.5 * np.abs(np.diff(sharp, axis=1)).max()
    assert soft.sum() == pytest.approx(sharp.sum(), rel=1e-3)


@pytest.mark.parametrize(
    "picture", [np.zeros((120, 213), np.uint8), np.zeros((120, 214, 3), np.uint8), np.zeros((120, 214))]
)
def test_pictures_of_another_kind_are_refused(room: SimulatedRoom, picture: np.ndarray) -> None:
    with pytest.raises(ValueError, match="214 × 120"):
        SimulatedProjector(room).show(picture)


def test_open_rig_returns_devices_and_the_truth_separately() -> None:
    settings = SimulatedRigSettings(seed=3, interreflection=False, ambient=0)
    with open_rig(settings, (153, 128), (107, 60)) as opened:
        assert (opened.rig.camera.size, opened.rig.projector.size) == ((153, 128), (107, 60))
        opened.rig.projector.show(np.full((60, 107), 255, np.uint8))
        assert opened.rig.camera.grab().image.shape == (128, 153)
        assert opened.truth is not None
        assert opened.truth.unit == "m"
        assert opened.truth.camera.focal_px[0] == pytest.approx(1791.1 * 153 / 2448)
        assert not hasattr(opened.rig, "truth")
        assert opened.rig.identity == {"backend": "simulated", "seed": "3", "pose": "0"}


@pytest.mark.parametrize("wrong", [{"sed": 1}, {"seed": -1}, {"walls_off_deg": 30}, {"bit_depth": 9}, {"backend": "x"}])
def test_impossible_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        SimulatedRigSettings.model_validate(wrong)


@given(st.floats(-0.06, 0.03), st.floats(-0.01, 0.01), st.integers(0, 1000))
def test_the_lens_agrees_with_the_calibration_model(k1: float, k2: float, seed: int) -> None:
    optics = Optics(612, 512, 447.8, (314.0, 263.6), k1, k2)
    model = Intrinsics(612, 512, (447.8, 447.8), (314.0, 263.6), (k1, k2, 0.0, 0.0, 0.0))
    pixels = np.random.default_rng(seed).uniform((0, 0), (611, 511), (100, 2))
    rays = optics.to_rays(pixels.T)
    np.testing.assert_allclose(rays.T, model.unproject(pixels), atol=1e-8)
    np.testing.assert_allclose(optics.to_pixels(rays[0], rays[1]).T, pixels, atol=1e-5)


def test_a_negative_k1_pulls_the_corners_in() -> None:
    straight = Optics(612, 512, 447.8, (314.0, 263.6))
    corner = straight.to_rays(np.array([[0.0], [0.0]]))
    pulled = BARREL.to_pixels(corner[0], corner[1])[:, 0]
    assert np.all((pulled > 5) & (pulled < 20))


def test_directions_far_outside_the_image_are_not_seen() -> None:
    # Beyond its turning point the lens polynomial leads back into the image.
    assert not BARREL.sees(BARREL.to_pixels(np.array([5.0]), np.array([0.0]))).any()


@pytest.mark.parametrize(("width", "focal_px", "x0"), [(2448, 1791.1, 1256.3), (1224, 895.55, 628.15)])
def test_intrinsics_scale_with_the_width(width: int, focal_px: float, x0: float) -> None:
    optics = resized(Optics(2448, 2048, 1791.1, (1256.3, 1054.3)), width, 1024)
    assert (optics.focal_px, optics.principal_point_px[0]) == pytest.approx((focal_px, x0))


def test_the_response_is_a_power_above_the_black_level() -> None:
    levels = np.array([[0, 51, 128, 255]], np.uint8)
    light = PICTURE.linear(levels)[0]
    assert light[0] == pytest.approx(1e-3)
    assert light[3] == pytest.approx(1.0)
    np.testing.assert_allclose((light[1:3] - 1e-3) / 0.999, (levels[0, 1:3] / 255) ** 2.2, rtol=1e-5)


def test_blur_is_symmetric_and_conserves_light() -> None:
    light = np.zeros((24, 40), np.float32)
    light[11, 20] = 1.0
    fine = PICTURE.blurred(light)
    assert fine.sum() == pytest.approx(9.0, rel=1e-5)
    texels, weights = PICTURE.interpolate(np.array([[20.0, 19.2, 20.8, 20.0, 20.0], [11.0, 11.0, 11.0, 10.2, 11.8]]))
    middle, *sides = (fine[texels] * weights).sum(axis=1)
    assert 0.4 < middle < 0.6  # a square of one pixel under a Gaussian of half a pixel: erf(1 / √2)² = 0.466
    np.testing.assert_allclose(sides, sides[0], rtol=1e-5)
    assert 0.05 < sides[0] < middle / 2


def test_interpolation_at_a_pixel_centre_returns_that_pixel() -> None:
    x, y = np.meshgrid(np.arange(40.0), np.arange(24.0))
    pixels = np.array([[3.0, 20.25, 36.5], [4.0, 12.5, 19.75]])
    texels, weights = PICTURE.interpolate(pixels)
    for ramp, expected in ((x, pixels[0]), (y, pixels[1])):
        fine = PICTURE.blurred(ramp.astype(np.float32))
        np.testing.assert_allclose((fine[texels] * weights).sum(axis=1), expected, atol=0.02)


def test_the_pyramid_averages_over_the_footprint() -> None:
    light = np.random.default_rng(0).random((24, 40)).astype(np.float32)
    pyramid = PICTURE.pyramid(light)
    assert pyramid.size == PICTURE.texel_count
    pixels = np.array([[8.5, 8.0], [4.5, 4.0]])
    coarse, single = PICTURE.texels(pixels, np.array([4.0, 1.0]))
    assert pyramid[coarse] == pytest.approx(light[4:8, 8:12].mean(), rel=1e-5)
    assert pyramid[single] == light[4, 8]
