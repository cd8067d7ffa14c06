"""A rig whose camera streams, and whose projector is a screen."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from calib.numerics import Image
from hw.ahead import Ahead
from hw.rig import Frame
from hw.timing.automatics import appearance, changes, reference_picture
from hw.timing.devices import FlippingProjector, StreamingCamera
from hw.timing.resting import RestingLight
from hw.timing.stream_calibration import StreamTiming, calibrate_stream
from hw.timing.streaming import StreamAcquisition
from hw.timing.timed_rig import Tally, TimedRig

_MOST_AHEAD = 16  # frames that wait for whoever records and decodes them


@dataclass
class _Lately:
    """Of the last capture."""

    ahead: Ahead[Frame] | None = None
    repeated: int = 0
    dropped: int = 0
    changes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class StreamedRig(TimedRig):
    """Its frames are taken as pictures stand; a capture begins and ends with one picture that shows what the camera has
    changed by itself in between.
    """

    streaming: StreamingCamera
    timing: StreamTiming
    rest: RestingLight
    acquisition: StreamAcquisition
    _lately: _Lately = field(default_factory=_Lately)

    @property
    def latency_s(self) -> float:
        """From the swap of a picture until the first frame that may show some of it has come."""
        return self.timing.soonest_s

    @property
    def tally(self) -> Tally:
        """What the last frames cost."""
        return self.acquisition.tally

    def photograph(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float] = (),
        level: Sequence[Sequence[int]] = (),
        unpaired: Sequence[Sequence[int]] = (),
    ) -> Iterator[Frame]:
        """A frame of each image, taken while it stands. Those of a capture, of which some verify each other, are taken
        some ahead of who asks for them. Raises DeviceError.
        """
        if not (level or unpaired):
            self._lately.ahead = None
            return self.acquisition.frames(images, exposures_us)
        if exposures_us:
            level = unpaired = ()
        self._lately.ahead = Ahead(self._captured(images, exposures_us, level, unpaired), _MOST_AHEAD)
        return iter(self._lately.ahead)

    def stop(self) -> None:
        """Return when no frame is being taken, before the devices are closed."""
        if self._lately.ahead is not None:
            self._lately.ahead.stop()

    def account(self) -> Mapping[str, object]:
        """What was measured of the stream, what its frames cost, and what the camera changed by itself."""
        tally, timing = self.tally, self.timing
        limit_s = timing.soonest_s + 2 * timing.period_s
        return {
            "synchronisation": {
                "latency_ms": round(1e3 * timing.soonest_s, 1),
                "frame_period_ms": round(1e3 * timing.period_s, 2),
                "retriggered_frames": tally.retriggered,
                "doubted_frames": self.acquisition.doubted,
                "repeated_frames": self._lately.repeated,
                "dropped_frames": self._lately.dropped,
                "averaged_frames": self.streaming.average,
                "ms_per_frame": round(1e3 * tally.seconds_per_frame, 2),
                "overhead_percent": round(100 * (tally.seconds_per_frame / limit_s - 1), 1),
            },
            "camera_changed": {"after_white_percent": round(100 * timing.adapted, 1), **self._lately.changes},
        }

    def _captured(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float],
        level: Sequence[Sequence[int]],
        unpaired: Sequence[Sequence[int]],
    ) -> Iterator[Frame]:
        reader, lit = self.streaming.reader, self.rest.lit
        reference = reference_picture(self.projector.size)
        repeated, dropped = reader.repeated, reader.dropped
        first = appearance(self.acquisition.frame(reference).image, lit)
        yield from self.acquisition.frames(images, exposures_us, level, unpaired)
        last = appearance(self.acquisition.frame(reference).image, lit)
        self._lately.changes = changes(first, last)
        self._lately.repeated, self._lately.dropped = reader.repeated - repeated, reader.dropped - dropped


def streamed(
    projector: FlippingProjector, camera: StreamingCamera, identity: dict[str, str], refresh_hz: float | None = None
) -> StreamedRig:
    """A rig whose latency has been measured, which takes about seven seconds.

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
        streaming=camera,
        timing=timing,
        rest=rest,
        acquisition=acquisition,
    )
