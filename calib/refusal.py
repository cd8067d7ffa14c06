"""Why a capture cannot be calibrated."""


class RefusalError(Exception):
    """No trustworthy calibration can be had from these matches.

    `reason` is one short sentence that names the cause; `advice` says what to do about it.
    """

    def __init__(self, reason: str, advice: str) -> None:
        super().__init__(f"{reason} {advice}")
        self.reason = reason
        self.advice = advice
