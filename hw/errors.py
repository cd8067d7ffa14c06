"""Errors of devices."""


class DeviceError(Exception):
    """A camera or projector failed, or is not there. The message names the device and says what to do."""


class OverexposedError(DeviceError):
    """Everything that the projector lights is clipped in the camera's image, so that nothing can be measured there."""


class FrameLostError(Exception):
    """A frame did not arrive, or not whole. The message says how; taking it again may help."""
