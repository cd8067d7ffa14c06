"""Errors of devices."""


class DeviceError(Exception):
    """A camera or projector failed, or is not there. The message names the device and says what to do."""


class OverexposedError(DeviceError):
    """Every pixel that the projector lights is clipped in the camera's image."""


class FrameLostError(Exception):
    """A frame did not arrive, or is incomplete. The message says how; a retry may help. `camera`: whose it was."""

    camera = ""
