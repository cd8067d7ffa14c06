"""Synchronisation without a trigger line, of a camera and a projector that know nothing of each other.

A picture is on the wall some tens of milliseconds after the graphics card has swapped it in; how many nobody says, so
flashes measure it. With that, several pictures are on their way at once (`pipelined.py`); where that does not work, a
picture leaves when the last one has been exposed (`sequential.py`).
"""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import Frame
from hw.timing.devices import TRIGGER_LAG_S, BufferedProjector, TriggeredCamera
from hw.timing.latency import LONGEST_LATENCY_S, LOST_ADVICE, Latency, LatencyCalibration
from hw.timing.pipelined import PipelinedAcquisition
from hw.timing.sequential import SequentialAcquisition, Timing
from hw.timing.timed_rig import Tally, TimedRig
from hw.timing.trigger_schedule import pace

log = logging.getLogger(__name__)

# Beyond the slowest flash: flips wait for the screen's refresh, clocks and schedulers are not exact.
_MARGIN_S = 0.004
_ROUNDS = 8
# Pipelined, a picture's time is short, and what it takes beside the exposure counts for every frame.
_PIPELINED_MARGINS_S = (0.001, 0.003, 0.006, 0.012, 0.024)
_REHEARSED_PIPELINED = 8


def _rehearsed_sequential(
    calibration: LatencyCalibration, projector: BufferedProjector, camera: TriggeredCamera, latency_s: float
) -> Timing:
    """Sequential acquisition, as soon after a flip as frames of black and white show that they may be.

    What shows in the rehearsal is a picture that came too late, or, where pictures and frames overlap, the next one
    that came too early: into the last rows of a rolling shutter, or into an exposure that began late. Raises
    DeviceError if the light does not settle.
    """
    timing = Timing(latency_s, latency_s + _MARGIN_S, overlaps=latency_s > TRIGGER_LAG_S)
    for _ in range(_ROUNDS):
        missing = calibration.largest_missing_share(SequentialAcquisition(projector, camera, timing).frames)
        log.info("%s: %.2f %% of the light missing", timing, 100 * missing)
        if missing < calibration.tolerance:
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


def _rehearsed_pipelined(
    calibration: LatencyCalibration,
    measured: Latency,
    projector: BufferedProjector,
    camera: TriggeredCamera,
    sequential: SequentialAcquisition,
) -> PipelinedAcquisition | None:
    """Pipelined acquisition as dense as frames of black and white show that they may be; None if they may not at all.

    What shows is what does in sequential acquisition, and whatever makes pictures later, or sooner, when others are on
    their way, too.
    """
    for margin_s in _PIPELINED_MARGINS_S:
        rhythm = pace(measured, camera, margin_s)
        if rhythm.period_s > sequential.period_s(measured.cycle_s) + camera.wait_s:
            break
        pipelined = PipelinedAcquisition(projector, camera, sequential, rhythm, calibration.sums)
        missing = calibration.largest_missing_share(pipelined.rehearse, _REHEARSED_PIPELINED)
        log.info("%s: %.2f %% of the light missing, %d missed", rhythm, 100 * missing, pipelined.missed)
        if missing < calibration.tolerance:
            return pipelined
    return None


@dataclass
class _Flown:
    """Whether the acquisition of the last frames was pipelined."""

    lately: bool = False


@dataclass(frozen=True, kw_only=True)
class SynchronisedRig(TimedRig):
    """A rig whose camera is triggered, with sequential acquisition, or pipelined, where that was found to work: for one
    frame of each picture of a capture.
    """

    lost_advice = LOST_ADVICE

    timing: Timing
    sequential: SequentialAcquisition
    pipelined: PipelinedAcquisition | None = None
    _flown: _Flown = field(default_factory=_Flown)

    @property
    def latency_s(self) -> float:
        """From the swap of a picture to its light."""
        return self.timing.latency_s

    @property
    def tally(self) -> Tally:
        """What the last frames cost."""
        return self.sequential.tally

    @property
    def least_s(self) -> float:
        """Exposure and, where acquisition is not pipelined, latency."""
        return self.sequential.exposure_s + (0.0 if self._flown.lately else self.timing.latency_s)

    def _acquired(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float],
        level: Sequence[Sequence[int]],
        unpaired: Sequence[Sequence[int]],
    ) -> Iterator[Frame]:
        flying = self.pipelined if (level or unpaired) and not exposures_us else None
        self._flown.lately = flying is not None and flying.possible
        if flying is not None and self._flown.lately:
            return flying.frames(images, level, unpaired)
        return self.sequential.frames(images, exposures_us)

    def _measured(self) -> Mapping[str, object]:
        found: dict[str, object] = {
            "delay_ms": round(1e3 * self.timing.delay_s, 2),
            "overlapping": self.timing.overlaps,
        }
        if self.pipelined is not None and self._flown.lately:
            found |= {
                "pictures_in_flight": self.pipelined.rhythm.outstanding,
                "missed_in_flight": self.pipelined.missed,
                "doubted_frames": self.pipelined.doubted,
            }
        return found


def synchronised(
    projector: BufferedProjector, camera: TriggeredCamera, identity: dict[str, str], refresh_hz: float | None = None
) -> SynchronisedRig:
    """A rig whose latency has been measured, by flashes, and tried out, which takes about four seconds; where the
    camera has no clock, so long is waited as no projector takes.

    Raises DeviceError if the camera does not see the projector, or its light does not settle.
    """
    calibration = LatencyCalibration(projector, camera)
    if not camera.capabilities.clock:  # flashes tell nothing to a camera that begins to expose nobody knows when
        timing = _rehearsed_sequential(calibration, projector, camera, LONGEST_LATENCY_S)
        known = identity | {"light after a flip": f"within {1e3 * timing.delay_s:.0f} ms (waited for)"}
        sequential = SequentialAcquisition(projector, camera, timing)
        return SynchronisedRig(projector, camera, known, refresh_hz, timing=timing, sequential=sequential)
    measured = calibration.latency()
    timing = _rehearsed_sequential(calibration, projector, camera, measured.latest_s)
    sequential = SequentialAcquisition(projector, camera, timing)
    known_when = isfinite(camera.wait_s)
    pipelined = _rehearsed_pipelined(calibration, measured, projector, camera, sequential) if known_when else None
    known = identity | {"light after a flip": f"{1e3 * timing.latency_s:.1f} ms (measured)"}
    return SynchronisedRig(
        projector, camera, known, refresh_hz, timing=timing, sequential=sequential, pipelined=pipelined
    )
