"""Why a capture cannot be calibrated, or a thing not be measured."""


class RefusalError(Exception):
    """No trustworthy calibration can be had from these matches.

    `reason` is one short sentence that names the cause; `advice` says what to do about it.
    """

    refused = "calibration"

    def __init__(self, reason: str, advice: str) -> None:
        super().__init__(f"{reason} {advice}")
        self.reason = reason
        self.advice = advice


class NoMeasurementError(RefusalError):
    """No trustworthy measurement of a thing can be had from a cloud; `reason` and `advice` as above."""

    refused = "measurement"
