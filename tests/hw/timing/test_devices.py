import pytest

from hw.timing.devices import whole_periods


@pytest.mark.parametrize(
    ("wanted_ms", "refresh_hz", "periods"),
    [(33.3, 60.0, 2), (1.0, 60.0, 1), (24.9, 60.0, 1), (25.1, 60.0, 2), (33.3, 120.0, 4), (40.0, 59.94, 2)],
)
def test_exposures_are_rounded_to_whole_refresh_periods(wanted_ms: float, refresh_hz: float, periods: int) -> None:
    exposure_us, found = whole_periods(1e3 * wanted_ms, refresh_hz)
    assert found == periods
    assert exposure_us == pytest.approx(periods * 1e6 / refresh_hz)
