"""Errors of devices."""


class DeviceError(Exception):
    """A camera or projector failed, or is not there. The message names the device and says what to do."""
