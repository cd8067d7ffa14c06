"""Smooth errors of a film are those measured at import, plus those of any frames."""

import pytest

from scanner.capture import with_smooth_errors_of_film


@pytest.mark.parametrize(
    ("metadata", "expected_px"),
    [
        ({}, 0.0003),
        ({"recording": {"smooth_px": 0.0004}}, 0.0005),
        ({"recording": {"smooth_px": 0.0}}, 0.0003),
        ({"recording": {}}, 0.0012),
        ({"recording": {"smooth_px": "small"}}, 0.0012),
        ({"recording": {"smooth_px": float("nan")}}, 0.0012),
        ({"recording": {"smooth_px": -1}}, 0.0012),
    ],
)
def test_smooth_errors_of_a_film_are_added(metadata: dict[str, object], expected_px: float) -> None:
    assert with_smooth_errors_of_film(0.0003, metadata) == pytest.approx(expected_px)
