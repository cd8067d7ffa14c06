"""What is said of one device of a network is used for that device."""

import pytest

from calib.geometry import Size
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.reconstruction import lenses_by_name

SIZE = Size(640, 480)


def config(**cameras: dict[str, object]) -> Config:
    return Config.model_validate(
        {
            "camera": {"principal_point": {"prior": "centre", "sigma_px": 20}},
            "lens": {"radial": 0.01},
            "rigs": {
                "cameras": {"left": {}, **cameras},
                "projectors": {"stage": {"projector": {"principal_point": {"known": [320, 470]}}}, "side": {}},
            },
        }
    )


def test_a_device_has_its_own_principal_point() -> None:
    both = config(right={"camera": {"principal_point": {"known": [300, 250]}}})
    assert both.of_device("left").principal_point(SIZE).px == (319.5, 239.5)
    assert both.of_device("right").principal_point(SIZE).px == (300, 250)
    lenses = lenses_by_name(both, {"left": SIZE, "right": SIZE}, {"stage": SIZE, "side": SIZE})
    known = lenses["stage"].point
    assert known is not None
    assert known.px == (320, 470)
    assert lenses["side"].point is None


def test_a_device_has_its_own_lens() -> None:
    both = config(right={"lens": {"radial": 0}})
    lenses = lenses_by_name(both, {"left": SIZE, "right": SIZE}, {"stage": SIZE, "side": SIZE})
    assert lenses["left"].sigma[0] == pytest.approx(0.01)
    assert lenses["right"].sigma[0] < 1e-4
    assert lenses["stage"].point is not None


def test_an_impossible_point_names_the_device() -> None:
    both = config(right={"camera": {"principal_point": {"known": "middle"}}})
    with pytest.raises(InputError, match="rigs: right"):
        both.of_device("right")
