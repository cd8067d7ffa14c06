"""Names of quantities and devices, the same on every page and in every table."""

from calib.geometry import Calibration

FACE_NAMES = ("A", "B", "C")


def device_names(calibration: Calibration, number: int = 1, among: int = 1) -> tuple[str, str]:
    """Return the names of both devices of capture `number` (from 1, the oldest) of `among`. Pairs of photos have one
    camera.

    Every pair of photos includes the first; the newest pair is the one with the second.
    """
    if calibration.one_camera:
        return "photo 1", f"photo {among - number + 2}"
    which = f" {number}" if among > 1 else ""
    return f"camera{which}", f"projector{which}"
