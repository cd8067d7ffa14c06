"""Exposures as whole refresh periods of the projector."""


def whole_periods(exposure_us: float, refresh_hz: float) -> tuple[float, int]:
    """The nearest exposure that is a whole number of refresh periods, in microseconds, and that number (at least 1).

    A projector builds each picture up over a refresh period, so other exposures would miss a part of it in some rows.
    """
    period_us = 1e6 / refresh_hz
    periods = max(1, round(exposure_us / period_us))
    return periods * period_us, periods
