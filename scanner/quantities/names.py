"""What things are called on every page and in every table."""

from calib.geometry import Calibration

FACE_NAMES = ("A", "B", "C")


def device_names(calibration: Calibration, number: int = 1, among: int = 1) -> tuple[str, str]:
    """Of both devices of capture `number` (from 1, the oldest) of so many, which only photos have one camera for.

    Every pair of photos has the first one; the newest pair is that with the second.
    """
    if calibration.one_camera:
        return "photo 1", f"photo {among - number + 2}"
    which = f" {number}" if among > 1 else ""
    return f"camera{which}", f"projector{which}"
