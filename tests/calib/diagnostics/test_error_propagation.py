"""Propagated errors match the effect of errors put into a calibration."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnostics import (
    NOWHERE,
    Along,
    LinearFit,
    Spread,
    SystematicErrors,
    Uncertainty,
    calibration_of,
    length_in_the_middle,
    plane_form,
    spread_of_fit,
    spread_of_points,
    spread_of_vertex,
    stacked,
)
from calib.diagnostics.spatial_errors import smooth_error_px, smooth_modes
from calib.geometry import Calibration, Matches, Sigmas, intersect
from calib.numerics import Floats, blocks
from calib.pointcloud import FittedPlane, dihedral_angle_rad, dihedral_gradients, fit_plane
from calib.refinement import SHARED, State
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

SIZES = (PAPER_CAMERA.size, PAPER_PROJECTOR.size)
STEP = np.array(
    [
        3e-3,
        2,
        -1,
        1e-3,
        5e-4,
        2e-4,
        -1e-4,
        1e-4,
        -2e-3,
        1,
        2,
        -1e-3,
        4e-4,
        -2e-4,
        1e-4,
        1e-4,
        5e-4,
        -3e-4,
        6e-4,
        4e-4,
        -7e-4,
    ]
)


@pytest.fixture(scope="module")
def matches() -> Matches:
    found = random_capture(np.random.default_rng(4), count=6_000, noise_px=0.02).matches
    return replace(found, sigma_px=np.full(len(found), 0.02))


@pytest.fixture(scope="module")
def state() -> State:
    rig = random_capture(np.random.default_rng(4), count=6_000, noise_px=0.02).calibration
    camera, projector = (
        np.array([device.focal_px[0], *device.principal_point_px, *device.distortion])
        for device in (rig.camera, rig.projector)
    )
    return State(camera, projector, rig.pose.in_baselines)


def in_metres(state: State, baseline_m: float = 0.4) -> Calibration:
    return calibration_of(state, *SIZES, Sigmas()).scaled(baseline_m, "m")


def uncertainty_of(state: State, step: Floats, along: Along = NOWHERE) -> Uncertainty:
    return Uncertainty(state, np.outer(step, step), None, 0.02, along)


def planes_of(matches: Matches, calibration: Calibration) -> list[FittedPlane]:
    found = []
    for face in range(3):
        part = matches.on_face(face)
        cluster = blocks(np.rint(part.camera_px).astype(np.int64), 38)
        found.append(fit_plane(intersect(part, calibration).points, cluster))
    return found


def spreads_of(matches: Matches, errors: SystematicErrors) -> list[Spread]:
    found = []
    for face, plane in enumerate(planes_of(matches, errors.calibration)):
        part = matches.on_face(face)
        cluster = blocks(np.rint(part.camera_px).astype(np.int64), 38)
        direction = np.broadcast_to(plane.normal, (len(part), 3))
        found.append(spread_of_fit(LinearFit(plane.influence, direction, plane.covariance, cluster), part, errors))
    return found


@pytest.mark.parametrize("curved", [False, True])
def test_a_step_of_the_calibration_moves_angles_and_vertex_as_predicted(
    matches: Matches, state: State, curved: bool
) -> None:
    step = (0.1 if curved else 0.01) * STEP
    along = Along(step[None], np.ones(1)) if curved else NOWHERE
    errors = SystematicErrors.of(in_metres(state), uncertainty_of(state, step, along))
    before, after = planes_of(matches, errors.calibration), planes_of(matches, in_metres(state.moved(step)))
    spreads = spreads_of(matches, errors)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        moved = dihedral_angle_rad(after[i], after[j])[0] - dihedral_angle_rad(before[i], before[j])[0]
        gradient = np.concatenate(dihedral_gradients(before[i], before[j]))[None]
        told = stacked([spreads[i], spreads[j]]).through(gradient).budget()
        assert told.calibration == pytest.approx(abs(moved), rel=0.05, abs=1e-6)
        assert 0 < told.scatter < 1e-3
    vertex, spread = spread_of_vertex(before, spreads)
    shift = spread_of_vertex(after, spreads)[0] - vertex
    assert [spread.budget(axis).calibration for axis in range(3)] == pytest.approx(abs(shift), rel=0.05, abs=1e-5)


def test_a_known_distance_has_only_its_own_sigma(matches: Matches, state: State) -> None:
    """With a known distance to the vertex, errors of the calibration change everything else."""
    errors = SystematicErrors.of(in_metres(state), uncertainty_of(state, 0.1 * STEP), 0.01)
    vertex, spread = spread_of_vertex(planes_of(matches, errors.calibration), spreads_of(matches, errors))
    length = float(np.linalg.norm(vertex))
    by_vertex = vertex[None] / length
    assert spread.through(by_vertex).budget().scale == pytest.approx(0.01 * length, rel=1e-3)
    assert spread.through(by_vertex).budget().calibration > 1e-4
    anchored = errors.anchored(spread.through(by_vertex), length, 0.002)
    _, known = spread_of_vertex(planes_of(matches, errors.calibration), spreads_of(matches, anchored))
    assert known.through(by_vertex).budget().calibration < 1e-6
    assert known.through(by_vertex).budget().scale == pytest.approx(0.002 * length, rel=1e-3)


def test_lengths_at_the_middle_of_the_cloud(matches: Matches, state: State) -> None:
    points = intersect(matches, in_metres(state)).points
    exact = SystematicErrors.of(in_metres(state), uncertainty_of(state, np.zeros(SHARED)), 0.003)
    assert length_in_the_middle(points, exact).sigma == pytest.approx(0.003, rel=1e-6)
    wrong = SystematicErrors.of(in_metres(state), uncertainty_of(state, 0.1 * STEP), 0.003)
    assert 0.003 < length_in_the_middle(points, wrong).sigma < 0.1


def test_point_errors_match_their_sigmas(matches: Matches, state: State) -> None:
    rng, errors = np.random.default_rng(0), SystematicErrors.of(in_metres(state), None)
    part = matches[:200]
    assert part.sigma_px is not None
    told = spread_of_points(part, errors, part.sigma_px)
    noisy = replace(part, projector_px=part.projector_px + rng.normal(0, 0.02, part.projector_px.shape))
    moved = intersect(noisy, errors.calibration).points - intersect(part, errors.calibration).points
    sigma = np.sqrt(np.diag(told.scatter)).reshape(-1, 3)
    assert 0.9 < np.sqrt(np.mean((moved / sigma) ** 2)) < 1.1


def test_smooth_errors_are_distinguished_from_scatter() -> None:
    rng = np.random.default_rng(1)
    pixel = rng.uniform(0, 600, (20_000, 2))
    modes, cluster = smooth_modes(pixel), blocks(pixel.astype(np.int64), 10)
    scatter = rng.normal(0, 0.05, len(pixel))
    assert 0 <= smooth_error_px(scatter, modes, cluster) < 0.001
    wavy = scatter + 0.02 * modes[:, 4] - 0.02 * modes[:, 8]
    assert smooth_error_px(wavy, modes, cluster) == pytest.approx(0.02 * np.sqrt(2 / 5), rel=0.15)


def test_the_shape_of_a_bent_face() -> None:
    rng = np.random.default_rng(2)
    place = rng.uniform(-1, 1, (8_000, 2))
    bow = 1e-3 * (place[:, 0] ** 2 - 1 / 3)
    points = np.column_stack([place, 3 + 0.2 * place[:, 0] + bow + rng.normal(0, 2e-4, len(place))])
    pixel = 300 + 200 * place
    cluster = blocks(pixel.astype(np.int64), 20)
    found = plane_form(fit_plane(points, cluster), pixel, cluster)
    assert found.deviation == pytest.approx(np.std(bow) / np.sqrt(1.04), rel=0.1)
    assert 1e-6 < np.sqrt(np.trace(found.covariance)) < 3e-5
