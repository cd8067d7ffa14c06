"""Several captures of one rig: one corner or several, faces in any order, no prior knowledge."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.diagnostics import RIG_CHANGED
from calib.geometry import Matches
from calib.refinement import PrincipalPoint, shared_corner
from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration, self_calibrate_jointly
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, SyntheticCapture, random_captures
from tests.support.findings import kinds_of, the_only

CAMERA_SIZE = (PAPER_CAMERA.width, PAPER_CAMERA.height)
PROJECTOR_SIZE = (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)
CENTRE = PrincipalPoint(((CAMERA_SIZE[0] - 1) / 2, (CAMERA_SIZE[1] - 1) / 2), 73.0)
RIG: dict[str, Any] = {
    "camera": replace(PAPER_CAMERA, distortion=(-0.02, 0.0, 0.0, 0.0, 0.0)),
    "projector": replace(PAPER_PROJECTOR, distortion=(-0.01, 0.0, 0.0, 0.0, 0.0)),
}


def _calibrate(
    captures: list[SyntheticCapture], point: PrincipalPoint, *, squareness_deg: float = 0.3, same: bool = True
) -> tuple[SelfCalibration, ...]:
    return self_calibrate_jointly(
        [capture.matches for capture in captures],
        CAMERA_SIZE,
        PROJECTOR_SIZE,
        principal_point=point,
        squareness_deg=squareness_deg,
        same=same,
    )


def _errors(found: SelfCalibration) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of f_c, f_p, x_p, y_p, and the errors in sigmas."""
    calibration = found.calibration
    values = [calibration.camera.focal_px[0], calibration.projector.focal_px[0]]
    values += calibration.projector.principal_point_px
    truth = np.array([PAPER_CAMERA.focal_px[0], PAPER_PROJECTOR.focal_px[0], *PAPER_PROJECTOR.principal_point_px])
    sigma = calibration.sigma
    sigmas = [sigma.camera.focal_px[0], sigma.projector.focal_px[0], *sigma.projector.principal_point_px]
    return np.array(values) / truth - 1, (np.array(values) - truth) / np.array(sigmas)


def test_two_captures_of_one_corner_measure_its_angles() -> None:
    captures = random_captures(np.random.default_rng(21), 2, walls_off_deg=0.3, count=20_000, **RIG)
    found = _calibrate(captures, KNOWN)
    error, deviation = _errors(found[0])
    assert 1e-6 < np.abs(error).mean() < 0.005
    assert np.abs(deviation).max() < 5
    assert found[0].calibration is found[1].calibration

    angles = [result.corner.angles_deg for result in found]
    assert np.allclose(angles[0], angles[1], atol=1e-6)
    true = captures[0].corner.angles_deg
    assert min(np.abs(np.sort(angles[0]) - np.sort(true))) < 0.05
    assert np.abs(np.sort(angles[0]) - np.sort(true)).max() < 0.15


@pytest.mark.parametrize(
    ("device", "name"), [("projector", "the projector's focal length"), ("camera", "the camera's focal length")]
)
def test_captures_of_two_rigs_name_what_differs(device: str, name: str) -> None:
    """Only captures that are fine alone are said to be of two rigs."""
    zoomed = replace(RIG[device], focal_px=tuple(1.02 * focal for focal in RIG[device].focal_px))
    first, again = random_captures(np.random.default_rng(47), 2, walls_off_deg=0.3, count=5_000, **RIG)
    _, second = random_captures(np.random.default_rng(47), 2, walls_off_deg=0.3, count=5_000, **RIG | {device: zoomed})
    with pytest.raises(RefusalError) as caught:
        _calibrate([first, again, second], CENTRE)
    finding = caught.value.finding
    assert finding.kind == RIG_CHANGED
    assert finding.data["captures"] in ((1, 3), (2, 3))
    found = re.search(r"change of (.*) by ([\d.]+) % ± ([\d.]+) %", finding.message)
    assert found
    assert found[1] == name
    assert 1.9 < float(found[2]) < 2.1
    assert 50 < float(found[2]) / float(found[3]) < 2000


def test_captures_that_no_common_corner_fits_get_angles_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a fit ends with no finite cost in any order of the faces."""
    captures = random_captures(np.random.default_rng(21), 2, walls_off_deg=0.3, count=5_000, **RIG)
    fits = shared_corner._in_order
    monkeypatch.setattr(
        shared_corner,
        "_in_order",
        lambda *given: replace(trial := fits(*given), fit=replace(trial.fit, cost=np.inf)),
    )
    found = _calibrate(captures, KNOWN)
    assert "different-corners" in kinds_of(found[0].findings)
    assert np.abs(_errors(found[0])[1]).max() < 5


def test_faces_are_numbered_consistently_in_captures_of_one_corner() -> None:
    captures = random_captures(np.random.default_rng(3), 3, walls_off_deg=0.3, count=20_000, **RIG)
    found = _calibrate(captures, KNOWN)
    assert found[0].order_nats > 7
    for result, capture in zip(found, captures, strict=True):
        # The angle opposite to each leg, by the truth in this capture's own numbers, carried to the numbers found.
        old, new = capture.matches.face, result.matches.face
        carried = [capture.corner.angles_deg[np.bincount(old[new == face]).argmax()] for face in range(3)]
        assert np.abs(result.corner.angles_deg - carried).max() < 0.1


def test_three_captures_need_no_prior_knowledge() -> None:
    captures = random_captures(np.random.default_rng(8), 3, walls_off_deg=0.3, count=20_000, **RIG)
    found = _calibrate(captures, CENTRE)
    error, deviation = _errors(found[0])
    assert 1e-6 < np.abs(error).mean() < 0.0035
    assert np.abs(deviation).max() < 5
    point = np.array(found[0].calibration.camera.principal_point_px) - PAPER_CAMERA.principal_point_px
    assert 1e-4 < np.abs(point).max() < 4


def test_captures_of_one_corner_find_tangential_terms() -> None:
    camera, projector = (
        replace(RIG[name], distortion=(RIG[name].distortion[0], 0.0, *terms, 0.0))
        for name, terms in (("camera", (6e-4, -4e-4)), ("projector", (-5e-4, 3e-4)))
    )
    captures = random_captures(
        np.random.default_rng(21), 2, walls_off_deg=0.3, count=20_000, camera=camera, projector=projector
    )
    (found, _) = _calibrate(captures, KNOWN)
    error, deviation = _errors(found)
    assert 1e-6 < np.abs(error).mean() < 0.01
    assert np.abs(deviation).max() < 5
    sigma = found.calibration.sigma
    for device, true, known in (
        (found.calibration.camera, camera, sigma.camera),
        (found.calibration.projector, projector, sigma.projector),
    ):
        assert known.distortion is not None
        off = np.subtract(device.distortion, true.distortion)[2:4]
        assert np.all(np.abs(off) < 5 * np.array(known.distortion[2:4]))
        assert 0 < np.abs(off).max() < 3e-4

    captures = random_captures(np.random.default_rng(21), 2, walls_off_deg=0.3, count=20_000, **RIG)
    plain = _calibrate(captures, KNOWN)[0].calibration
    for device, known in ((plain.camera, plain.sigma.camera), (plain.projector, plain.sigma.projector)):
        assert known.distortion is not None
        assert np.all(np.abs(device.distortion[2:4]) < 4 * np.array(known.distortion[2:4]))
        assert 0 < max(known.distortion[2:4]) < 1e-4


def test_different_square_corners_determine_the_principal_point() -> None:
    captures = random_captures(np.random.default_rng(5), 2, same=False, count=20_000, **RIG)
    found = _calibrate(captures, CENTRE, squareness_deg=0.0)
    error, _ = _errors(found[0])
    assert 1e-6 < np.abs(error).mean() < 0.0025
    assert np.abs(np.array(found[0].calibration.camera.principal_point_px) - PAPER_CAMERA.principal_point_px).max() < 2


def test_different_corners_are_distinguished() -> None:
    captures = random_captures(np.random.default_rng(4), 2, walls_off_deg=0.5, same=False, count=20_000, **RIG)
    found = _calibrate(captures, KNOWN, squareness_deg=0.5)
    assert "different-corners" in kinds_of(found[0].findings)
    apart = _calibrate(captures, KNOWN, squareness_deg=0.5, same=False)
    assert np.allclose(_errors(found[0])[0], _errors(apart[0])[0], atol=1e-4)
    assert np.abs(_errors(found[0])[1]).max() < 5


def test_a_capture_with_too_few_matches_is_named() -> None:
    captures = random_captures(np.random.default_rng(1), 2, count=5_000, **RIG)
    second = captures[1].matches
    flat = second.on_face(0)
    x = flat.camera_px[:, 0]
    strips = np.digitize(x, np.quantile(x, [1 / 3, 2 / 3])).astype(np.int32)
    captures[1] = replace(captures[1], matches=Matches(flat.camera_px, flat.projector_px, strips))
    with pytest.raises(RefusalError, match="capture 2 are not those of a corner: all lie in one plane"):
        _calibrate(captures, KNOWN)


def test_a_repeated_view_adds_no_information() -> None:
    """The same view twice with other noise is named, and counts about once."""
    rng = np.random.default_rng(21)
    (capture,) = random_captures(rng, 1, walls_off_deg=0.3, count=20_000, **RIG)
    noise = rng.normal(0, 0.1, capture.matches.projector_px.shape)
    again = replace(capture, matches=replace(capture.matches, projector_px=capture.matches.projector_px + noise))
    once, twice = _calibrate([capture], KNOWN)[0], _calibrate([capture, again], KNOWN)[0]
    assert "from-one-place" not in kinds_of(once.findings)
    assert the_only("from-one-place", twice.findings).numbers("captures") == (1, 2)
    sigmas = [found.calibration.sigma.camera.focal_px for found in (once, twice)]
    assert sigmas[0] is not None
    assert sigmas[1] is not None
    assert 0.8 < sigmas[1][0] / sigmas[0][0] < 1.5
