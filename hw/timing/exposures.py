"""Exposures that suit a projector."""


def whole_periods(exposure_us: float, refresh_hz: float) -> tuple[float, int]:
    """The exposure nearest to the wanted one that is a whole number of refresh periods, and that number.

    A projector builds each picture up over a refresh period; any other exposure would cut some rows' pictures short.
    """
    period_us = 1e6 / refresh_hz
    periods = max(1, round(exposure_us / period_us))
    return periods * period_us, periods
