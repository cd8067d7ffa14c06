"""Clouds and meshes are registered without a first guess, or it is said why there is no answer."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from calib.geometry import Pose, rotation_vector
from calib.numerics import Floats, Ints
from calib.pointcloud import surface
from calib.registration import Alignment, SurfacePoints, SurfaceRegistration, is_closed, register_surfaces, sample_mesh
from calib.synthetic import STATION_CAMERA, CloudErrors, random_furnished_room, ring, seen_from
from tests.support.blob import Blob

BLOB = Blob()


def a_pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(Rotation.random(rng=rng).as_matrix(), 200.0 * rng.standard_normal(3))


def moved(points: Floats, normals: Floats | None, pose: Pose) -> SurfacePoints:
    return SurfacePoints(pose @ points, None if normals is None else pose.rotate(normals))


def whitened(found: SurfaceRegistration, truth: Pose) -> Floats:
    """The six errors, independent and of unit variance if the covariance is right."""
    assert found.best is not None
    change = found.best.pose @ truth.inverse()
    step = np.append(rotation_vector(change.rotation), change @ found.centre - found.centre)
    return np.linalg.solve(np.linalg.cholesky(found.covariance), step)


@pytest.mark.parametrize(("seed", "with_normals"), [(0, True), (1, False)])
def test_overlapping_parts_are_registered_with_a_true_sigma(seed: int, with_normals: bool) -> None:
    first, second = BLOB.cloud(30_000, seed, (0, 0, 1)), BLOB.cloud(20_000, 10 + seed, (0.9, 0, 0.6))
    truth = a_pose(seed)
    there = moved(second[0], second[1] if with_normals else None, truth.inverse())
    found = register_surfaces(SurfacePoints(first[0], first[1] if with_normals else None), there)
    assert found.alignment is Alignment.UNIQUE
    assert found.best is not None
    assert 0.3 < found.best.overlap[1] < 0.95
    assert found.best.share > 0.98
    off = np.linalg.norm(found.best.pose @ there.points - second[0], axis=1)
    assert 1e-6 < off.max() < 0.05
    sigma = np.sqrt(found.position_covariance(np.array([[0.0, 0, 1]]), found.centre[None]))
    assert 1e-4 < sigma[0] < 0.01


def test_sigmas_of_two_views_are_neither_too_small_nor_too_large() -> None:
    errors = []
    for seed in range(16):
        aside = (np.cos(seed), np.sin(seed), 0.6)
        first, second = BLOB.cloud(24_000, seed, (0, 0, 1)), BLOB.cloud(16_000, 100 + seed, aside)
        truth = a_pose(seed)
        there = moved(*second, truth.inverse())
        errors.append(whitened(register_surfaces(SurfacePoints(*first), there, starts=truth[None]), truth))
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_a_part_is_found_on_a_mesh_whatever_way_its_faces_are() -> None:
    vertices, triangles = BLOB.mesh()
    triangles[::3] = triangles[::3, ::-1]
    mesh = SurfacePoints(*sample_mesh(vertices, triangles, 40_000), 0.0)
    points, normals = BLOB.cloud(20_000, 2, (0.3, -0.5, 0.6))
    truth = a_pose(2)
    found = register_surfaces(mesh, moved(points, normals, truth.inverse()))
    assert found.alignment is Alignment.UNIQUE
    assert found.best is not None
    assert np.linalg.norm(found.best.pose @ truth.inverse().__matmul__(points) - points, axis=1).max() < 0.05


def test_a_scale_is_estimated() -> None:
    first, second = BLOB.cloud(30_000, 3), BLOB.cloud(15_000, 4, (0, 1, 0.3))
    there = moved(second[0] / 250.0, second[1], a_pose(3))
    found = register_surfaces(SurfacePoints(*first), there, (240.0, 260.0), with_scale=True)
    assert found.alignment is Alignment.UNIQUE
    assert found.best is not None
    assert found.covariance.shape == (7, 7)
    sigma = float(np.sqrt(found.covariance[6, 6]))
    assert 1e-6 < sigma < 1e-3
    assert abs(np.log(found.best.scale / 250.0)) < 4 * sigma


def test_a_surface_in_another_unit_is_told_from_one_of_few_points() -> None:
    points = BLOB.cloud(2000, 5)[0]
    smaller, sparser = SurfacePoints(points / 1000.0), SurfacePoints(points[:9])
    with pytest.raises(ValueError, match=r"2,000 points, 0\.\d+ across, cover 1 cells, expected more than 12"):
        register_surfaces(SurfacePoints(points), smaller)
    with pytest.raises(ValueError, match=r"cells \d\d\.\d wide, .* cover \d+ cells.* too sparse\?"):
        register_surfaces(SurfacePoints(points), sparser)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_answer_is_the_same_in_any_unit(unit: float) -> None:
    (points, normals), part, truth = BLOB.cloud(20_000, 3), BLOB.cloud(15_000, 4, (0, 1, 0.3)), a_pose(3)
    there = moved(unit * part[0], part[1], Pose(truth.rotation, unit * truth.translation))
    found = register_surfaces(SurfacePoints(unit * points, normals), there, (1.03,), with_scale=True)
    assert found.alignment is Alignment.UNIQUE
    assert found.best is not None
    assert abs(np.log(found.best.scale)) < 4 * float(np.sqrt(found.covariance[6, 6])) < 4e-3
    off = np.linalg.norm(found.best.pose @ (found.best.scale * there.points) - unit * part[0], axis=1)
    assert 1e-6 * unit < off.max() < 0.1 * unit


def test_a_mirror_image_and_another_body_fit_nowhere() -> None:
    points, normals = BLOB.cloud(20_000, 5, (0, 0, 1))
    mirrored, there = BLOB.cloud(30_000, 6)
    flip = np.array([-1.0, 1.0, 1.0])
    for other in (
        SurfacePoints(flip * mirrored, flip * there),
        SurfacePoints(*Blob((30, 50, 45), 6.0).cloud(30_000, 7)),
    ):
        found = register_surfaces(other, moved(points, normals, a_pose(5)))
        assert found.alignment is Alignment.NONE
        assert np.isnan(found.covariance).all()


def test_an_ellipsoid_fits_in_four_ways() -> None:
    body = Blob(waves=0.0)
    found = register_surfaces(SurfacePoints(*body.cloud(20_000, 8)), moved(*body.cloud(15_000, 9), a_pose(8)))
    assert found.alignment is Alignment.AMBIGUOUS
    assert found.best is not None
    assert len(found.alternatives) == 3
    angles = [np.degrees(found.best.pose.angle_from(alternative.pose)) for alternative in found.alternatives]
    assert np.allclose(angles, 180.0, atol=2.0)


def test_what_slides_or_turns_is_named() -> None:
    ball = Blob((40, 40, 40), 0.0)
    found = register_surfaces(SurfacePoints(*ball.cloud(20_000, 10)), moved(*ball.cloud(15_000, 11), a_pose(10)))
    assert found.alignment is Alignment.LOOSE
    assert [motion.turns for motion in found.free] == [True] * 3
    assert all(np.linalg.norm(motion.through) < 5.0 for motion in found.free)
    body = Blob((40, 40, 25), 0.0)
    found = register_surfaces(SurfacePoints(*body.cloud(20_000, 12)), moved(*body.cloud(15_000, 13), a_pose(12)))
    assert found.alignment is Alignment.LOOSE
    (motion,) = found.free
    assert motion.turns
    assert abs(motion.direction[2]) > 0.99
    rng = np.random.default_rng(14)
    plate = np.hstack([rng.uniform(0, [100.0, 60.0], (20_000, 2)), 0.02 * rng.standard_normal((20_000, 1))])
    up = np.broadcast_to([0.0, 0.0, 1.0], plate.shape)
    found = register_surfaces(SurfacePoints(plate, up), SurfacePoints(plate[::2], up[::2]))
    assert found.alignment is Alignment.LOOSE
    assert sorted(motion.turns for motion in found.free) == [False, False, True]


def test_too_few_points_are_refused() -> None:
    few = SurfacePoints(np.random.default_rng(0).standard_normal((5, 3)))
    with pytest.raises(ValueError, match="more than"):
        register_surfaces(few, few)


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 1000))
def test_the_answer_does_not_depend_on_the_frame(seed: int) -> None:
    first, second = BLOB.cloud(12_000, 20, (0, 0, 1)), BLOB.cloud(12_000, 21, (0.4, 0.2, 1))
    one, other = a_pose(seed), a_pose(seed + 1)
    found = register_surfaces(moved(*first, one), moved(*second, other))
    assert found.best is not None
    assert found.alignment is Alignment.UNIQUE
    back = one.inverse() @ found.best.pose @ other
    assert np.linalg.norm(back @ second[0] - second[0], axis=1).max() < 0.1


def stations(seed: int, pieces: int, step_deg: float) -> tuple[SurfacePoints, SurfacePoints, Pose]:
    """What two neighbouring stations see of a room, and the pose of the second one on the first."""
    rng = np.random.default_rng([seed, 11])
    room = random_furnished_room(rng, pieces)
    places = ring(rng, room, 6, step_deg)[:2]
    views = []
    for place in places:
        cloud = seen_from(room, place, rng, CloudErrors(shape=0.0)).points
        normals = surface(cloud, float(np.mean(STATION_CAMERA.focal_px))).normals
        there = np.isfinite(cloud[..., 2]) & np.isfinite(normals[..., 2])
        views.append(SurfacePoints(cloud[there].astype(np.float64), normals[there].astype(np.float64), eye=np.zeros(3)))
    return views[0], views[1], places[0].inverse() @ places[1]


@pytest.mark.parametrize("seed", [305, 306, 3000])
def test_a_room_is_not_taken_for_its_mirror_image(seed: int) -> None:
    first, second, _ = stations(seed, 8, 60.0)
    mirror, normals = np.array([-1.0, 1.0, 1.0]), second.normals
    assert normals is not None
    found = register_surfaces(first, SurfacePoints(mirror * second.points, mirror * normals, eye=np.zeros(3)))
    assert found.alignment is Alignment.AMBIGUOUS
    assert found.best is not None
    assert not found.best.is_mirrored
    assert all(pose.is_mirrored for pose in found.alternatives)
    assert all(pose.agreeing > found.best.agreeing for pose in found.alternatives)


@pytest.mark.parametrize(("seed", "pieces", "step_deg"), [(309, 8, 60.0), (307, 2, 30.0)])
def test_furniture_tells_poses_apart_at_which_walls_coincide(seed: int, pieces: int, step_deg: float) -> None:
    first, second, truth = stations(seed, pieces, step_deg)
    found = register_surfaces(first, second)
    assert found.alignment is Alignment.UNIQUE
    assert found.best is not None
    assert found.best.shows_more_than_bounds
    assert 1e-5 < np.linalg.norm(found.best.pose.translation - truth.translation) < 0.02


def hull_of(corners: Floats) -> Ints:
    """Triangles of the convex hull of corners (N, 3), outwards."""
    hull = ConvexHull(corners)
    a, b, c = corners[hull.simplices.T]
    outwards = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) > 0
    return np.where(outwards[:, None], hull.simplices, hull.simplices[:, ::-1]).astype(np.int64)


def test_a_part_of_flat_faces_is_answered_though_its_mirror_image_fits_as_well() -> None:
    angle = np.radians([0.0, 50, 85, 150, 200, 275, 310])
    corners = np.array([[30 * np.cos(a), 30 * np.sin(a), z] for a in angle for z in (0.0, 30.0)])
    points, normals = sample_mesh(corners, hull_of(corners), 60_000)
    seen = normals @ np.array([0.5, 0.6, 0.62]) > 0.2
    noise = 0.02 * np.random.default_rng(0).standard_normal((len(points), 1))
    truth = a_pose(20)
    found = register_surfaces(
        SurfacePoints(points, normals, 0.0), moved((points + noise * normals)[seen], normals[seen], truth.inverse())
    )
    assert found.alignment is Alignment.UNIQUE
    assert found.best is not None
    assert np.linalg.norm(found.best.pose @ truth.inverse().__matmul__(points) - points, axis=1).max() < 0.1


def box(size: tuple[float, float, float], corner: tuple[float, float, float]) -> tuple[Floats, Ints]:
    """Corners and triangles of a box, outwards."""
    vertices = np.array(list(product((0.0, 1.0), repeat=3))) * size + corner
    return vertices, hull_of(vertices)


def test_a_view_that_a_whole_model_explains_is_answered_though_half_of_it_fits_elsewhere() -> None:
    """A bracket seen from one side: turned by half a turn, its plate and its wall lie on themselves."""
    boxes = [
        box((100, 60, 10), (0, 0, 0)),
        box((10, 60, 50), (0, 0, 10)),
        box((30, 10, 20), (40, 50, 10)),
        box((12, 8, 6), (70, 10, 10)),
    ]
    vertices = np.concatenate([corners for corners, _ in boxes])
    triangles = np.concatenate([of_box + 8 * number for number, (_, of_box) in enumerate(boxes)])
    assert is_closed(vertices, triangles)
    assert is_closed(vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)), "as of STL"
    assert not is_closed(vertices, triangles[1:])
    points, normals = sample_mesh(vertices, triangles, 60_000)
    low, high = (np.array([of(corners[:, :2], axis=0) for corners, _ in boxes[1:]]) for of in (np.min, np.max))
    on_plate = np.all((points[:, None, :2] > low) & (points[:, None, :2] < high), axis=2).any(axis=1)
    hidden = on_plate & (np.abs(points[:, 2] - 10) < 0.1)
    seen = (normals @ np.array([0.68, -0.41, 0.61]) > 0.2) & ~hidden
    noise = 0.02 * np.random.default_rng(0).standard_normal((len(points), 1))
    truth = a_pose(21)
    view = moved((points + noise * normals)[seen], normals[seen], truth.inverse())
    found = register_surfaces(SurfacePoints(points, normals, 0.0, is_closed=True), view)
    assert found.alignment is Alignment.UNIQUE
    assert found.best is not None
    assert np.linalg.norm((found.best.pose @ truth.inverse()) @ points - points, axis=1).max() < 0.1
    # Of a scan of the bracket, more may be elsewhere.
    assert register_surfaces(SurfacePoints(points, normals, 0.0), view).alignment is Alignment.AMBIGUOUS
