from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, DeviceSigmas, Intrinsics, Pose, Sigmas
from scanner.errors import InputError
from scanner.io.calibration_file import read_calibration, write_calibration

CALIBRATION = Calibration(
    Intrinsics(2448, 2048, (1791.1, 1791.2), (1256.3, 1054.3), (-0.06, 0.01, 1e-5, -2e-17, 0.0)),
    Intrinsics(854, 480, (1247.3, 1247.3), (377.1, 234.0)),
    Pose(Rotation.from_rotvec([0.1, -0.2, 1 / 3]).as_matrix(), np.array([-0.4, 0.05, 1 / 7])),
    "m",
    Sigmas(DeviceSigmas((1.5, 1.5)), DeviceSigmas(principal_point_px=(0.1, 0.2))),
)

positive = st.floats(0.1, 1e5)
number = st.floats(-1e5, 1e5)
term = st.floats(-1e4, 1e4)


@st.composite
def calibrations(draw: st.DrawFn) -> Calibration:
    def device() -> Intrinsics:
        return Intrinsics(
            draw(st.integers(1, 10_000)),
            draw(st.integers(1, 10_000)),
            (draw(positive), draw(positive)),
            (draw(number), draw(number)),
            draw(st.tuples(term, term, term, term, term)),
        )

    rotation = Rotation.from_rotvec([draw(st.floats(-2, 2)) for _ in range(3)]).as_matrix()
    translation = np.array([draw(number), draw(number), draw(positive)])
    unit = draw(st.sampled_from(["baseline", "m", "mm", "y", "1", "no", "#", "null", ": "]))
    pairs, triples = (st.none() | st.tuples(*[positive] * count) for count in (2, 3))

    def sigmas() -> DeviceSigmas:
        terms = draw(st.none() | st.lists(positive, min_size=1, max_size=5))
        return DeviceSigmas(draw(pairs), draw(pairs), None if terms is None else tuple(terms))

    single = st.none() | positive
    sigma = Sigmas(sigmas(), sigmas(), draw(triples), draw(single), draw(triples), draw(single), draw(single))
    return Calibration(device(), device(), Pose(rotation, translation), unit, sigma)


def same(a: Calibration, b: Calibration) -> bool:
    return (
        (a.camera, a.projector, a.unit, a.sigma) == (b.camera, b.projector, b.unit, b.sigma)
        and np.array_equal(a.pose.rotation, b.pose.rotation)
        and np.array_equal(a.pose.translation, b.pose.translation)
    )


@given(calibrations())
def test_every_number_reads_back_the_same(tmp_path_factory: pytest.TempPathFactory, calibration: Calibration) -> None:
    path = tmp_path_factory.getbasetemp() / "calibration.yaml"
    write_calibration(path, calibration)
    assert same(read_calibration(path), calibration)


def test_the_keys_of_the_file_format_are_fixed(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.yaml", CALIBRATION)
    data = yaml.safe_load((tmp_path / "calibration.yaml").read_text())
    assert list(data) == ["camera", "projector", "rotation", "translation", "unit", "sigma"]
    assert list(data["camera"]) == ["width", "height", "focal_px", "principal_point_px", "distortion"]
    assert data["camera"]["focal_px"] == [1791.1, 1791.2]
    assert data["sigma"] == {"camera_focal_px": 1.5, "projector_principal_point_px": [0.1, 0.2]}
    np.testing.assert_array_equal(data["rotation"], CALIBRATION.pose.rotation)


def written(tmp_path: Path, **changes: object) -> Path:
    path = tmp_path / "calibration.yaml"
    write_calibration(path, CALIBRATION)
    data = yaml.safe_load(path.read_text())
    for key, value in changes.items():
        section, _, name = key.partition("__")
        place, last = (data[section], name) if name else (data, section)
        if value is None:
            del place[last]
        else:
            place[last] = value
    path.write_text(yaml.safe_dump(data))
    return path


def test_a_short_distortion_is_padded_with_zeros(tmp_path: Path) -> None:
    assert read_calibration(written(tmp_path, camera__distortion=[-0.1, 0.2])).camera.distortion == (-0.1, 0.2, 0, 0, 0)
    assert read_calibration(written(tmp_path, camera__distortion=[])).camera.distortion == (0,) * 5
    assert read_calibration(written(tmp_path, camera__distortion=None)).camera.distortion == (0,) * 5


def test_keys_of_other_readers_are_ignored(tmp_path: Path) -> None:
    assert same(read_calibration(written(tmp_path, date="2026-01-01", camera__serial=7)), CALIBRATION)


def test_sigma_may_be_left_out(tmp_path: Path) -> None:
    assert read_calibration(written(tmp_path, sigma=None)).sigma == Sigmas()


def test_sigmas_of_other_programs_are_read(tmp_path: Path) -> None:
    sigma = {"camera_focal_px": [1, 2.5], "camera_principal_point_px": 3, "corner_angles_deg": 0.1, "skew": 1.0}
    found = read_calibration(written(tmp_path, sigma=sigma)).sigma
    assert found == Sigmas(DeviceSigmas((1.0, 2.5), (3.0, 3.0)), corner_angles_deg=(0.1, 0.1, 0.1))


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no camera": ({"camera": None}, "'camera' is missing"),
    "no unit": ({"unit": None}, "'unit' is missing"),
    "no focal": ({"projector__focal_px": None}, "'projector.focal_px' is missing"),
    "one focal": ({"camera__focal_px": [1000]}, r"'camera.focal_px\[1\]' is missing"),
    "negative focal": (
        {"camera__focal_px": [1000, -1000]},
        r"'camera.focal_px\[1\]' must be greater than or equal to 0.1, found -1000",
    ),
    "endless focal": ({"camera__focal_px": [1000, float("inf")]}, r"'camera.focal_px\[1\]' must be a finite number"),
    "word as focal": ({"camera__focal_px": ["f", 1]}, r"'camera.focal_px\[0\]' must be a valid number, found 'f'"),
    "six distortions": ({"camera__distortion": [0.0] * 6}, "'camera.distortion' must have at most 5 items"),
    "two rows": ({"rotation": [[1, 0, 0], [0, 1, 0]]}, r"'rotation\[2\]' is missing"),
    "no rotation": ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "rotation must be orthonormal"),
    "mirror": ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "determinant"),
    "no baseline": ({"translation": [0, 0, 0]}, "translation must not be zero"),
    "no size": ({"camera__width": 0}, "'camera.width' must be greater than or equal to 1"),
    "three focal sigmas": ({"sigma": {"camera_focal_px": [1, 1, 1]}}, "sigma.camera_focal_px"),
    "negative sigma": ({"sigma": {"camera_focal_px": -1}}, "sigma.camera_focal_px"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_calibration_is_refused(tmp_path: Path, name: str) -> None:
    changes, message = WRONG[name]
    with pytest.raises(InputError, match=f"calibration.yaml: .*{message}"):
        read_calibration(written(tmp_path, **changes))


def test_a_missing_calibration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_calibration(tmp_path / "calibration.yaml")
