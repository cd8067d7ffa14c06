"""Synchronisation without a trigger line, of a camera and a projector that know nothing of each other.

A picture is on the wall some tens of milliseconds after the graphics card has swapped it in; how many nobody says, so
flashes measure it. With that, several pictures are on their way at once (`hw/flight.py`); where that does not work, a
picture leaves when the last one has been exposed (`hw/turns.py`).
"""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

from calib.numerics import Image
from hw.ahead import Ahead
from hw.appointments import pace
from hw.errors import DeviceError
from hw.flashes import Flashes, Latency
from hw.flight import Flight
from hw.rig import Frame, Rig
from hw.timed_devices import TRIGGER_LAG_S, BufferedProjector, TriggeredCamera
from hw.turns import Timing, Turns

log = logging.getLogger(__name__)

# Beyond the slowest flash: flips wait for the screen's refresh, clocks and schedulers are not exact.
_MARGIN_S = 0.004
_ROUNDS = 8
# In flight, a picture's time is short, and what it takes beside the exposure counts for every frame.
_FLIGHT_MARGINS_S = (0.001, 0.003, 0.006, 0.012, 0.024)
_REHEARSED_IN_FLIGHT = 8
MOST_AHEAD = 16  # frames that wait for whoever records and decodes them: eight may be proven by one, and come at once


def _rehearsed_in_turns(
    flashes: Flashes, projector: BufferedProjector, camera: TriggeredCamera, latency_s: float
) -> Timing:
    """Pictures in turns, as soon after a flip as frames of black and white show that they may be.

    What shows in the rehearsal is a picture that came too late, or, where pictures and frames overlap, the next one
    that came too early: into the last rows of a rolling shutter, or into an exposure that began late. Raises
    DeviceError if the light does not settle.
    """
    timing = Timing(latency_s, latency_s + _MARGIN_S, overlaps=latency_s > TRIGGER_LAG_S)
    for _ in range(_ROUNDS):
        missing = flashes.largest_missing_share(Turns(projector, camera, timing).frames)
        log.info("%s: %.2f %% of the light missing", timing, 100 * missing)
        if missing < flashes.tolerance:
            return timing
        if timing.overlaps:
            timing = replace(timing, overlaps=False)
        else:
            late_s = max(_MARGIN_S, missing * camera.exposure_s)  # a tail of light fades slower than its share tells
            timing = Timing(timing.latency_s + late_s, timing.delay_s + late_s, overlaps=False)
    raise DeviceError(
        f"projector: its light does not settle: {1e3 * timing.delay_s:.0f} ms after a flip, an exposure still differs "
        f"by {100 * missing:.1f} % from one of a resting picture. Turn off whatever adapts (dynamic contrast, "
        "automatic iris, eco mode), keep daylight and people out, then rerun."
    )


def _rehearsed_in_flight(
    flashes: Flashes, measured: Latency, projector: BufferedProjector, camera: TriggeredCamera, turns: Turns
) -> Flight | None:
    """Pictures in flight as densely as frames of black and white show that they may be; None if they may not at all.

    What shows is what does in turns, and whatever makes pictures later, or sooner, when others are on their way, too.
    """
    for margin_s in _FLIGHT_MARGINS_S:
        rhythm = pace(measured, camera, margin_s)
        if rhythm.period_s > turns.period_s(measured.cycle_s) + camera.wait_s:
            break
        flight = Flight(projector, camera, turns, rhythm, flashes.sums)
        missing = flashes.largest_missing_share(flight.rehearse, _REHEARSED_IN_FLIGHT)
        log.info("%s: %.2f %% of the light missing, %d missed", rhythm, 100 * missing, flight.missed)
        if missing < flashes.tolerance:
            return flight
    return None


@dataclass
class _Lately:
    """How the last frames were taken."""

    flew: bool = False
    ahead: Ahead[Frame] | None = None


@dataclass(frozen=True, kw_only=True)
class SynchronisedRig(Rig):
    """A rig of real devices, which take turns, or whose pictures are in flight, where that was found to work."""

    timing: Timing
    turns: Turns
    flight: Flight | None = None
    _lately: _Lately = field(default_factory=_Lately)

    def photograph(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float] = (),
        level: Sequence[Sequence[int]] = (),
        unpaired: Sequence[Sequence[int]] = (),
    ) -> Iterator[Frame]:
        """A frame of each image, taken when its light is on the wall. Raises DeviceError.

        Images of which some prove each other are a capture: its frames are taken some ahead of who asks for them, and
        its pictures are in flight, where that works, each for one frame. All others are taken in turns, when they are
        asked for.
        """
        captures = bool(level or unpaired)
        flying = self.flight if captures and not exposures_us else None
        self._lately.flew = flying is not None and flying.possible
        if flying is not None and self._lately.flew:
            frames = flying.frames(images, level, unpaired)
        else:
            frames = self.turns.frames(images, exposures_us)
        self._lately.ahead = Ahead(frames, MOST_AHEAD) if captures else None
        return iter(self._lately.ahead or frames)

    def stop(self) -> None:
        """Return when no frame is being taken, before the devices are closed."""
        if self._lately.ahead is not None:
            self._lately.ahead.stop()

    def account(self) -> Mapping[str, object]:
        """What synchronisation measured, and what the frames so far cost over what was unavoidable."""
        tally = self.turns.tally
        return {
            "synchronisation": {
                "latency_ms": round(1e3 * self.timing.latency_s, 2),
                "delay_ms": round(1e3 * self.timing.delay_s, 2),
                "overlapping": self.timing.overlaps,
                "retriggered_frames": tally.retriggered,
                "ms_per_frame": round(1e3 * tally.seconds_per_frame, 2),
                "overhead_percent": round(100 * self.overhead, 1),
                **self._of_flight(),
            }
        }

    def _of_flight(self) -> dict[str, object]:
        found: dict[str, object] = {}
        if self.flight is not None and self._lately.flew:
            found |= {
                "pictures_in_flight": self.flight.rhythm.in_flight,
                "missed_in_flight": self.flight.missed,
                "doubted_frames": self.flight.doubted,
            }
        if self._lately.ahead is not None:
            found["waited_for_computer_s"] = round(self._lately.ahead.waited_s, 3)
        return found

    @property
    def overhead(self) -> float:
        """Time per frame beyond exposure and (where pictures are not in flight) latency, relative to these."""
        waited_s = 0.0 if self._lately.flew else self.timing.latency_s
        return self.turns.tally.seconds_per_frame / (self.turns.exposure_s + waited_s) - 1


def synchronised(
    projector: BufferedProjector, camera: TriggeredCamera, identity: dict[str, str], refresh_hz: float | None = None
) -> SynchronisedRig:
    """A rig whose latency has been measured, by flashes, and tried out, which takes about four seconds.

    Raises DeviceError if the camera does not see the projector, or its light does not settle.
    """
    flashes = Flashes(projector, camera)
    measured = flashes.latency()
    timing = _rehearsed_in_turns(flashes, projector, camera, measured.latest_s)
    turns = Turns(projector, camera, timing)
    known_when = isfinite(camera.wait_s)
    flight = _rehearsed_in_flight(flashes, measured, projector, camera, turns) if known_when else None
    known = identity | {"light after a flip": f"{1e3 * timing.latency_s:.1f} ms (measured)"}
    return SynchronisedRig(projector, camera, known, refresh_hz, timing=timing, turns=turns, flight=flight)
