"""Errors of devices."""


class DeviceError(Exception):
    """A camera or projector failed, or is not there. The message names the device and says what to do."""


class FrameLostError(Exception):
    """A frame did not arrive, or not whole. The message says how; taking it again may help."""
