"""A rig of a streaming camera and a projector that is a screen."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from calib.numerics import Image
from hw.rig import Frames, Redundancy
from hw.timing.devices import FlippingProjector, StreamingCamera
from hw.timing.stream_calibration import StreamTiming, calibrate_stream
from hw.timing.streaming import StreamAcquisition
from hw.timing.timed_rig import TimedRig
from hw.timing.verification import RestingLight


@dataclass(eq=False, kw_only=True)
class StreamedRig(TimedRig):
    """A rig with a streaming camera, which takes stable frames."""

    lost_advice = "Send smaller or fewer frames, by cable where there is one."

    streaming: StreamingCamera
    timing: StreamTiming
    rest: RestingLight
    acquisition: StreamAcquisition
    _lost_before: tuple[int, int] = field(default=(0, 0), init=False)
    """Counts of repeated and dropped frames at the begin of the last capture."""

    @property
    def least_s(self) -> float:
        """Latency and two frame periods, the time of a single picture; pipelined pictures can take less."""
        return self.timing.soonest_s + 2 * self.timing.period_s

    def account(self) -> Mapping[str, object]:
        """As for every timed rig, and automatic changes of the camera."""
        changed = {"after_white_percent": round(100 * self.timing.adapted, 1), **self.acquisition.changes}
        return {**super().account(), "camera_changed": changed}

    def _measured(self) -> Mapping[str, object]:
        reader = self.streaming.reader
        return {
            "frame_period_ms": round(1e3 * self.timing.period_s, 2),
            "missed_in_flight": self.acquisition.stable_frames.missed,
            "doubted_frames": self.acquisition.doubted,
            "repeated_frames": reader.repeated - self._lost_before[0],
            "dropped_frames": reader.dropped - self._lost_before[1],
            "averaged_frames": self.streaming.average,
        }

    def _acquired(
        self, images: Iterable[Image], exposures_us: Sequence[float], redundancy: Redundancy
    ) -> Iterator[Frames]:
        reader = self.streaming.reader
        self._lost_before = reader.repeated, reader.dropped
        return ((frame,) for frame in self.acquisition.frames(images, exposures_us, redundancy))


def streamed(
    projector: FlippingProjector, camera: StreamingCamera, identity: dict[str, str], refresh_hz: float | None = None
) -> StreamedRig:
    """Calibrate the latency, which takes about seven seconds, and return the rig.

    Raises DeviceError if the camera does not see the projector, is frozen, or delivers nothing.
    """
    timing, rest = calibrate_stream(projector, camera)
    acquisition = StreamAcquisition(projector, camera, timing, rest)
    known = identity | {"light after a flip": f"{1e3 * timing.soonest_s:.1f} ms (measured, with the camera's delay)"}
    return StreamedRig(
        projector,
        camera,
        known,
        refresh_hz,
        latency_s=timing.soonest_s,
        tally=acquisition.tally,
        streaming=camera,
        timing=timing,
        rest=rest,
        acquisition=acquisition,
    )
