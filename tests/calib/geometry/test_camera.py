"""The camera model: round trips, signs and refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry.camera import Intrinsics

LENSES = st.tuples(
    st.floats(-0.12, 0.1), st.floats(-0.02, 0.02), st.floats(-0.002, 0.002), st.floats(-0.002, 0.002), st.just(0.0)
)


@given(distortion=LENSES, x=st.floats(0, 1223), y=st.floats(0, 1023), depth=st.floats(0.1, 100))
def test_unproject_inverts_project(
    distortion: tuple[float, float, float, float, float], x: float, y: float, depth: float
) -> None:
    camera = Intrinsics(1224, 1024, (895.5, 900.0), (628.0, 527.0), distortion)
    pixel = np.array([[x, y]])
    back = camera.project(depth * camera.unproject(pixel))
    assert np.allclose(back, pixel, atol=1e-6)


def test_negative_k1_pulls_towards_the_centre() -> None:
    straight = Intrinsics(1000, 1000, (800.0, 800.0), (500.0, 500.0))
    barrel = Intrinsics(1000, 1000, (800.0, 800.0), (500.0, 500.0), (-0.1, 0.0, 0.0, 0.0, 0.0))
    point = np.array([[0.5, 0.0, 1.0]])
    # 800 · 0.5 · (1 − 0.1 · 0.25) = 390 to the right of the centre.
    assert straight.project(point)[0] == pytest.approx([900.0, 500.0])
    assert barrel.project(point)[0] == pytest.approx([890.0, 500.0])


def test_points_behind_the_device_project_to_nan() -> None:
    camera = Intrinsics(100, 100, (100.0, 100.0), (50.0, 50.0))
    assert np.isnan(camera.project(np.array([[0.0, 0.0, -1.0]]))).all()


def test_beyond_the_lens_model_is_nan() -> None:
    folded = Intrinsics(1000, 1000, (300.0, 300.0), (500.0, 500.0), (-0.3, 0.0, 0.0, 0.0, 0.0))
    rays = folded.unproject(np.array([[500.0, 500.0], [999.0, 999.0]]))
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1, :2]).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"focal_px": (0.0, 1.0)}, "positive"),
        ({"focal_px": (np.nan, 1.0)}, "finite"),
        ({"width": 0}, "size"),
    ],
)
def test_impossible_intrinsics_are_refused(change: dict[str, object], words: str) -> None:
    values: dict[str, object] = {"width": 10, "height": 10, "focal_px": (10.0, 10.0), "principal_point_px": (5.0, 5.0)}
    with pytest.raises(ValueError, match=words):
        Intrinsics(**(values | change))  # type: ignore[arg-type]
