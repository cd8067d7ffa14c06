"""Triggered cameras that expose together: a frame of each picture from all of them."""

from collections.abc import Callable, Sequence

from hw.errors import FrameLostError
from hw.rig import Frame, Frames, exposure_control
from hw.timing.devices import TriggeredCamera, nothing


class CameraGroup:
    """One triggered camera or several, used as a single one. Its frames are tuples, one frame for each of `cameras`.

    All are triggered one right after the other. The exposure of the group begins with the first and ends with the last.
    """

    def __init__(self, cameras: Sequence[TriggeredCamera]) -> None:
        self.cameras = tuple(cameras)
        self.triggered_s = [0.0] * len(self.cameras)
        """When each was triggered last, in seconds of the monotonic clock."""

    @property
    def name(self) -> str:
        """The names of all, for messages."""
        return " and ".join(camera.name for camera in self.cameras)

    @property
    def has_clock(self) -> bool:
        """Whether the begin of every exposure is known."""
        return all(camera.capabilities.clock for camera in self.cameras)

    @property
    def exposure_s(self) -> float:
        """The longest exposure."""
        return max(camera.exposure_s for camera in self.cameras)

    @property
    def wait_s(self) -> float:
        """The longest time from a trigger to the begin of its exposure; infinite if unknown of one."""
        return max(camera.wait_s for camera in self.cameras)

    @property
    def late_s(self) -> float:
        """From the first trigger to the begin of the last exposure, as far as `TriggeredCamera.late_s` tells it."""
        begun_s = [at_s + camera.late_s for at_s, camera in zip(self.triggered_s, self.cameras, strict=True)]
        return max(begun_s) - min(self.triggered_s)

    def expose_for(self, exposure_us: float) -> None:
        """Set the exposure of all. Raises DeviceError."""
        for camera in self.cameras:
            exposure_control(camera).expose_for(exposure_us)

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        """Expose a frame of each, and wait until all exposures are over. Raises DeviceError.

        Returns the time of the first trigger. `meanwhile` is called during the exposures.
        """
        self._expose_from(0, meanwhile)
        return min(self.triggered_s)

    def _expose_from(self, number: int, meanwhile: Callable[[], None]) -> None:
        """Each camera triggers the next one while it exposes."""
        if number == len(self.cameras):
            meanwhile()
            return
        self.triggered_s[number] = self.cameras[number].expose(lambda: self._expose_from(number + 1, meanwhile))

    def collect(self) -> Frames:
        """The last exposed frames. Raises DeviceError, or FrameLostError of the first camera that lost its frame."""
        frames, lost = list[Frame](), list[FrameLostError]()
        for camera in self.cameras:
            try:
                frames.append(camera.collect())
            except FrameLostError as error:
                error.camera = camera.name
                lost.append(error)
        if lost:
            raise lost[0]
        return tuple(frames)

    def grab(self) -> Frames:
        """Expose and collect."""
        self.expose()
        return self.collect()
