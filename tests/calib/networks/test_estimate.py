import re
from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Size
from calib.networks import NetworkEstimate, estimate_network
from calib.numerics import Floats
from calib.refinement import LensPrior
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network, random_waves, stations

OPTIONS = RoomOptions(boxes=1, count=6000)


def sizes_of(network: SyntheticNetwork) -> dict[str, Size]:
    return {name: device.size for name, device in network.devices.items()}


def errors(estimate: NetworkEstimate, network: SyntheticNetwork) -> tuple[Floats, Floats, Floats]:
    """Relative errors of focal lengths (devices,), errors of positions (devices,) in metres, and both over their
    sigmas, (4 devices − 4,).
    """
    first, second = (network.poses[name] for name in estimate.seed)
    unit = np.linalg.norm(second.translation - first.translation)
    focals, places, relative = [], [], []
    for name in estimate.names:
        device, sigma = estimate.device(name), estimate.sigmas(name)
        focals.append(np.log(device.lens[0] / network.devices[name].focal_px[0]))
        relative.append(focals[-1] / sigma[0])
        off = device.pose.translation * unit - first.inverse() @ network.poses[name].translation
        places.append(np.linalg.norm(off))
        if name != estimate.names[0]:
            relative.extend(off / unit / sigma[11:])
    return np.abs(focals), np.array(places), np.array(relative)


def without_faces_but(network: SyntheticNetwork, pair: tuple[str, str]) -> SyntheticNetwork:
    """Only one pair has labels; the others must find theirs."""
    captures = {
        each: matches if each == pair else matches.with_faces(np.full(len(matches), -1, np.int32))
        for each, matches in network.captures.items()
    }
    return replace(network, captures=captures)


@pytest.mark.parametrize(("cameras", "projectors", "focal", "place_m"), [(2, 1, 1e-2, 1e-2), (2, 2, 4e-3, 5e-3)])
def test_one_corner_determines_all_devices(cameras: int, projectors: int, focal: float, place_m: float) -> None:
    made = random_network(np.random.default_rng(3), cameras, projectors, OPTIONS)
    network = without_faces_but(made, ("camera1", "projector1"))

    estimate = estimate_network(network.captures, sizes_of(network))

    focals, places, relative = errors(estimate, network)
    assert set(estimate.names) == set(network.devices)
    assert 0 < focals.max() < focal
    assert 0 < places.max() < place_m
    assert 0.05 < np.sqrt(np.mean(relative**2)) < 2.2  # errors of one network go together


@pytest.mark.parametrize(("walls", "sights"), [(0, 0), (1, 1)])
def test_a_camera_that_sees_fewer_than_two_faces_is_placed_by_shared_points(walls: int, sights: int) -> None:
    """It sees boxes without labels, and at most one wall."""
    made = random_network(np.random.default_rng(4), 2, 1, replace(OPTIONS, boxes=5))
    captures = {
        pair: each.with_faces(np.where(each.labels < 3, each.labels, -1)) for pair, each in made.captures.items()
    }
    seen = made.captures["camera2", "projector1"]
    seen = seen[(seen.labels >= 3) | (seen.labels < walls)]
    captures["camera2", "projector1"] = replace(seen, face=None)

    estimate = estimate_network(captures, sizes_of(made))

    focals, places, relative = errors(estimate, made)
    assert sum(sight.camera == estimate.names.index("camera2") for sight in estimate.sights) == sights
    assert 0 < focals.max() < 0.02
    assert 0 < places.max() < 0.02
    assert 0.05 < np.sqrt(np.mean(relative**2)) < 2.0
    assert 0.7 < estimate.noise["camera2", "projector1"].match_px / OPTIONS.noise_px < 1.6


def test_an_observation_of_another_plane_gets_its_own_plane() -> None:
    """One pair sees the floor 5 cm higher."""
    made = random_network(np.random.default_rng(3), 2, 2, OPTIONS)
    pair = ("camera2", "projector2")
    seen = made.captures[pair]
    camera, projector = (made.devices[name] for name in pair)
    at, light = (made.poses[name] for name in pair)
    normals, offsets = made.scene.solids[0]
    rays = at.rotate(camera.unproject(seen.camera_px))
    higher = offsets[0] + 0.05 * np.sign(at.translation @ normals[0] - offsets[0])
    points = at.translation + rays * ((higher - at.translation @ normals[0]) / (rays @ normals[0]))[:, None]
    lit = projector.project(light.inverse() @ points)
    on = (seen.labels == 0) & np.isfinite(lit[:, 0])
    moved = replace(seen, projector_px=np.where(on[:, None], np.nan_to_num(lit), seen.projector_px))

    estimate = estimate_network({**made.captures, pair: moved}, sizes_of(made))

    planes = {sight.plane for sight in estimate.sights if sight.capture == list(estimate.noise).index(pair)}
    others = {sight.plane for sight in estimate.sights if sight.capture != list(estimate.noise).index(pair)}
    (own,) = planes - others
    floor = estimate.network.planes[0]
    first, second = (made.poses[name].translation for name in estimate.seed)
    apart = estimate.network.planes[own].offset - floor.offset
    assert abs(abs(apart) * np.linalg.norm(second - first) - 0.05) < 0.003
    assert estimate.noise[pair].smooth_px < 0.02
    assert 0 < errors(estimate, made)[0].max() < 0.004


def test_an_uneven_wall_is_reported_and_widens_sigmas(monkeypatch: pytest.MonkeyPatch) -> None:
    def of_the_floor(rng: np.random.Generator, options: RoomOptions) -> Floats:
        return random_waves(rng, options) * (np.arange(6) == 0)[:, None, None]

    monkeypatch.setattr(stations, "random_waves", of_the_floor)
    made = random_network(np.random.default_rng(3), 2, 2, replace(OPTIONS, wavy=0.003))

    estimate = estimate_network(made.captures, sizes_of(made))

    first, second = (made.poses[name].translation for name in estimate.seed)
    waves = estimate.waves * np.linalg.norm(second - first)
    assert 0.001 < waves[0] < 0.006
    assert waves[1:].max() < 0.001
    assert 0.05 < np.sqrt(np.mean(errors(estimate, made)[2] ** 2)) < 1.5


def test_prior_knowledge_of_a_device_is_used() -> None:
    made = random_network(np.random.default_rng(3), 2, 1, OPTIONS)
    known = {name: PrincipalPoint(made.devices[name].principal_point_px, 0.0) for name in ("camera1", "camera2")}
    centre = PrincipalPoint(made.devices["projector1"].principal_point_px, 0.0)
    lens = replace(LensPrior().with_sigmas(decentering=0.0), point=centre)

    usual = estimate_network(made.captures, sizes_of(made))
    told = estimate_network(made.captures, sizes_of(made), points=known, lenses={"projector1": lens})

    for name, point in {**known, "projector1": centre}.items():
        np.testing.assert_allclose(told.device(name).lens[1:3], point.px, rtol=1e-12)
        assert not told.sigmas(name)[1:3].any()
        assert 0 < told.sigmas(name)[0] < 0.9 * usual.sigmas(name)[0]
    assert not told.device("projector1").lens[5:7].any()
    assert usual.device("projector1").lens[5:7].all()
    assert 0.05 < np.sqrt(np.mean(errors(told, made)[2] ** 2)) < 1.5


def test_a_device_that_shares_no_light_is_named() -> None:
    made = random_network(np.random.default_rng(3), 2, 2, OPTIONS)
    apart = {pair: made.captures[pair] for pair in (("camera1", "projector1"), ("camera2", "projector2"))}

    with pytest.raises(
        RefusalError, match=r"^camera(.), projector\1: not connected with camera(.), projector\2\."
    ) as no:
        estimate_network(apart, sizes_of(made))

    assert "No capture is of one of these" in no.value.reason
    assert re.match(
        r"Take one of camera(.) in the light of projector(.), or of camera\2 in that of projector\1", no.value.advice
    )


def test_a_missing_overlap_is_named() -> None:
    """Two cameras see one half each of the projector's picture."""
    made = random_network(np.random.default_rng(3), 2, 1, OPTIONS)
    one, other = made.captures.values()
    right = (each.projector_px[:, 0] > made.devices["projector1"].width / 2 for each in (one, other))
    halves = one[next(right)], other[~next(right)]

    with pytest.raises(RefusalError) as no:
        estimate_network(dict(zip(made.captures, halves, strict=True)), sizes_of(made))

    assert re.search(
        r"In the picture of projector1, camera. sees its (left|right) part and camera. its", no.value.reason
    )
    assert re.search("Let camera. see what", no.value.advice)


def test_a_camera_that_sees_one_wall_is_placed_in_front_of_it() -> None:
    made = random_network(np.random.default_rng(3), 2, 1, OPTIONS)
    seen = made.captures["camera2", "projector1"]
    captures = {**made.captures, ("camera2", "projector1"): replace(seen[seen.labels == 0], face=None)}

    estimate = estimate_network(captures, sizes_of(made))

    _, places, relative = errors(estimate, made)
    assert 0 < places.max() < 0.05
    assert 0.05 < np.sqrt(np.mean(relative**2)) < 2.0
    assert 0 < estimate.sigmas("camera2")[0] < 0.05


def test_a_mirrored_picture_is_named() -> None:
    made = random_network(np.random.default_rng(3), 2, 2, OPTIONS)
    across = made.devices["projector2"].width - 1
    captures = dict(made.captures)
    for pair in (("camera1", "projector2"), ("camera2", "projector2")):
        right = captures[pair].projector_px
        captures[pair] = replace(captures[pair], projector_px=np.stack([across - right[:, 0], right[:, 1]], axis=1))

    with pytest.raises(RefusalError, match="picture of projector2 is seen as in a mirror"):
        estimate_network(captures, sizes_of(made))
    captures["camera1", "projector2"] = made.captures["camera1", "projector2"]
    with pytest.raises(RefusalError, match="camera2 in the light of projector2 is seen as in a mirror, but not"):
        estimate_network(captures, sizes_of(made))


def test_impossible_networks_are_refused() -> None:
    made = random_network(np.random.default_rng(3), 2, 1, OPTIONS)
    first, second = made.captures.values()

    with pytest.raises(ValueError, match="needs two pairs"):
        estimate_network({("a", "b"): first}, sizes_of(made))
    with pytest.raises(ValueError, match="'b' is the name of a camera and of a projector"):
        estimate_network({("a", "b"): first, ("b", "c"): second}, sizes_of(made))
    with pytest.raises(ValueError, match="'a' has no image size"):
        estimate_network({("a", "p"): first, ("b", "p"): second}, {"b": Size(4, 3), "p": Size(4, 3)})
