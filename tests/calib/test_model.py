"""The refinement's model: exact derivatives, and agreement with the devices' own projection."""

from dataclasses import replace

import numpy as np

from calib.camera import Intrinsics
from calib.model import Pose, State, predict
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, SyntheticCapture, random_capture

CAMERA = replace(PAPER_CAMERA, distortion=(-0.06, 0.01, 0.0, 0.0, 0.0))
PROJECTOR = replace(PAPER_PROJECTOR, distortion=(-0.03, 0.02, 0.0, 0.0, 0.0))


def _device(intrinsics: Intrinsics) -> np.ndarray:
    return np.array([intrinsics.focal_px[0], *intrinsics.principal_point_px, *intrinsics.distortion[:2]])


def _true_state(capture: SyntheticCapture) -> State:
    calibration = capture.calibration
    pose = Pose(capture.corner.legs, capture.corner.vertex / calibration.baseline)
    return State(
        _device(calibration.camera),
        _device(calibration.projector),
        calibration.rotation,
        calibration.translation / calibration.baseline,
        np.zeros((1, 3)),
        (pose,),
    )


def test_the_true_state_predicts_the_matches() -> None:
    rng = np.random.default_rng(1)
    capture = random_capture(rng, camera=CAMERA, projector=PROJECTOR, count=2000, noise_px=0.0)
    predicted, _, depths = predict(_true_state(capture), capture.matches.camera_px, capture.matches.face)
    assert np.abs(predicted - capture.matches.projector_px).max() < 1e-6
    assert depths.min() > 0


def test_derivatives_are_exact() -> None:
    rng = np.random.default_rng(2)
    capture = random_capture(rng, camera=CAMERA, projector=PROJECTOR, count=500)
    state = replace(_true_state(capture), off_square=np.radians([[0.4, -0.2, 0.7]]))
    _, jacobian, _ = predict(state, capture.matches.camera_px, capture.matches.face)
    for column in range(state.size):
        step = np.zeros(state.size)
        step[column] = 1e-6
        ahead, _, _ = predict(state.moved(step), capture.matches.camera_px, capture.matches.face)
        behind, _, _ = predict(state.moved(-step), capture.matches.camera_px, capture.matches.face)
        numerical = (ahead - behind) / 2e-6
        scale = np.abs(jacobian[:, :, column]).max()
        assert np.abs(numerical - jacobian[:, :, column]).max() < 1e-5 * scale, f"column {column}"


def test_angles_off_square_are_angles_between_the_faces() -> None:
    rng = np.random.default_rng(3)
    state = replace(_true_state(random_capture(rng, count=500)), off_square=np.radians([[0.5, -0.3, 0.2]]))
    normals = state.normals()
    between = [np.degrees(np.arcsin(normals[i] @ normals[j])) for i, j in ((1, 2), (2, 0), (0, 1))]
    assert np.allclose(between, [0.5, -0.3, 0.2], atol=0.005)
    assert np.allclose(np.sum(state.legs() * np.roll(normals, -1, axis=0), axis=1), 0, atol=1e-12)
