"""The refinement's model has exact derivatives, and matches the devices' projection."""

from dataclasses import replace

import numpy as np

from calib.refinement.likelihood import CornerProblem, Knowledge, Prior
from calib.refinement.parameters import FurtherPlane, State, predict
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, SyntheticCapture, random_capture
from tests.support.states import each_a_cell, true_state

CAMERA = replace(PAPER_CAMERA, distortion=(-0.06, 0.01, 0.0, 0.0, 0.0))
PROJECTOR = replace(PAPER_PROJECTOR, distortion=(-0.03, 0.02, 0.0, 0.0, 0.0))


def test_the_true_state_predicts_the_matches() -> None:
    rng = np.random.default_rng(1)
    capture = random_capture(rng, camera=CAMERA, projector=PROJECTOR, count=2000, noise_px=0.0)
    predicted, _, depths = predict(true_state(capture), capture.matches.camera_px, capture.matches.face)
    assert np.abs(predicted - capture.matches.projector_px).max() < 1e-6
    assert depths.min() > 0


def test_derivatives_are_exact() -> None:
    rng = np.random.default_rng(2)
    capture = random_capture(rng, camera=CAMERA, projector=PROJECTOR, count=500)
    state = replace(true_state(capture), off_square=np.radians([[0.4, -0.2, 0.7]]))
    _, jacobian, _ = predict(state, capture.matches.camera_px, capture.matches.face)
    for column in range(state.size):
        step = np.zeros(state.size)
        step[column] = 1e-6
        ahead, _, _ = predict(state.moved(step), capture.matches.camera_px, capture.matches.face)
        behind, _, _ = predict(state.moved(-step), capture.matches.camera_px, capture.matches.face)
        numerical = (ahead - behind) / 2e-6
        scale = np.abs(jacobian[:, :, column]).max()
        assert np.abs(numerical - jacobian[:, :, column]).max() < 1e-5 * scale, f"column {column}"


def _with_further_planes(state: State) -> State:
    planes = (
        FurtherPlane(np.eye(3), np.array([0.02, -0.01]), 0.4, (0.01, 0.01)),
        FurtherPlane(np.roll(np.eye(3), -1, axis=0), np.array([-0.03, 0.005]), 0.7, (0.01, 0.01)),
    )
    return replace(state, corners=(replace(state.corners[0], planes=planes),))


def test_derivatives_by_further_planes_are_exact() -> None:
    capture = random_capture(np.random.default_rng(2), camera=CAMERA, projector=PROJECTOR, count=500)
    state = _with_further_planes(true_state(capture))
    camera_px, plane = capture.matches.camera_px, np.arange(len(capture.matches)) % 5
    _, jacobian, _ = predict(state, camera_px, plane)
    for column, step in enumerate(1e-6 * np.eye(state.size)):
        ahead, behind = (predict(state.moved(s), camera_px, plane)[0] for s in (step, -step))
        scale = np.abs(jacobian[:, :, column]).max()
        assert np.abs((ahead - behind) / 2e-6 - jacobian[:, :, column]).max() < 1e-5 * scale, f"column {column}"
    own = jacobian[:, :, -6:].reshape(-1, 2, 2, 3)
    assert np.all(own[plane < 3] == 0)
    assert np.all(own[plane == 3, :, 1] == 0)
    assert np.all(own[plane == 4, :, 0] == 0)


def _prior(capture: SyntheticCapture, state: State) -> Prior:
    camera, projector = capture.calibration.camera, capture.calibration.projector
    sizes = (camera.width, camera.height), (projector.width, projector.height)
    return Knowledge(*sizes, (1200.0, 1000.0), 50.0, 0.3).prior(state)


def test_the_gradient_matches_the_cost() -> None:
    capture = random_capture(np.random.default_rng(4), camera=CAMERA, projector=PROJECTOR, count=400, outliers=0.1)
    cells = [each_a_cell(replace(capture, matches=capture.matches.with_faces(np.maximum(capture.matches.face, 0))))]
    state = true_state(capture)
    prior, variances = _prior(capture, state), [np.linspace(0.5, 1.5, len(cells[0]))]
    problem = CornerProblem.of(cells, prior, variances)
    fit = problem.evaluate(state)
    assert np.all(np.linalg.eigvalsh(fit.information) > -1e-6)
    for column, step in enumerate(1e-6 * np.eye(state.size)):
        ahead, behind = (problem.evaluate(state.moved(s)).cost for s in (step, -step))
        slope = (ahead - behind) / 4e-6
        assert abs(slope - fit.gradient[column]) < 1e-4 * np.sqrt(fit.information[column, column]), f"column {column}"


def test_cells_behind_a_device_cost_and_have_no_gradient() -> None:
    capture = random_capture(np.random.default_rng(5), count=2000)
    state, cells = true_state(capture), each_a_cell(capture)
    prior, variance = _prior(capture, state), np.ones(len(cells))
    whole = CornerProblem.of([cells], prior, [variance]).evaluate(state)
    one = np.flatnonzero(cells.plane == 0)[:1]
    beyond = cells.camera_px.copy()
    away = np.sign(capture.calibration.camera.project(capture.corner.vertex) - beyond[one[0]])
    beyond[one] += 1e5 * away  # across the horizon of its plane
    stray = CornerProblem.of([replace(cells, camera_px=beyond)], prior, [variance]).evaluate(state)
    assert np.all(stray.residuals[0][one] == 0)
    assert 50 < stray.cost - whole.cost < 101
    turned = replace(state, pose=state.pose.scaled(-50))
    assert CornerProblem.of([cells], prior, [variance]).evaluate(turned).cost == np.inf


def test_angles_off_square_are_angles_between_the_faces() -> None:
    rng = np.random.default_rng(3)
    state = replace(true_state(random_capture(rng, count=500)), off_square=np.radians([[0.5, -0.3, 0.2]]))
    normals = state.normals()
    between = [np.degrees(np.arcsin(normals[i] @ normals[j])) for i, j in ((1, 2), (2, 0), (0, 1))]
    assert np.allclose(between, [0.5, -0.3, 0.2], atol=0.005)
    assert np.allclose(np.sum(state.legs() * np.roll(normals, -1, axis=0), axis=1), 0, atol=1e-12)
