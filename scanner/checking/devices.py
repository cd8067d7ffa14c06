"""Whether both devices are there, and how they work together."""

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from calib.finding import Finding, FindingKind, Severity
from hw.errors import OverexposedError
from hw.open_rig import open_rig
from hw.rig import Rig
from hw.settings import CameraRigSettings
from hw.timing import TimedRig
from scanner.checking.report import CHECKED_DEVICES, CheckRow
from scanner.configuration import Config

# Lost frames are retaken and only cost time; this many indicate a problem.
_MANY_RETAKEN = 0.1

log = logging.getLogger(__name__)

# A completely white picture cannot be synchronised; with this much less light it can.
_SHORTER = 0.25
# Shorter than the refresh period of most projectors, and so than any exposure.
_SHORTEST_US = 10_000.0

CHECKED_TRANSFER = FindingKind(
    "check-transfer",
    "What scan check says of how fast frames arrive, and how many had to be taken again.",
    "Stop other work on the computer; give a network camera its own interface.",
)


@contextmanager
def opened(config: Config) -> Iterator[Rig]:
    """The configured rig, with a shorter exposure than configured where that is too bright to begin with.

    Raises InputError if the configuration names no rig or no sizes, DeviceError if the rig does not open.
    """
    settings = config.required_rig
    with ExitStack() as devices:
        while True:
            try:
                sizes = config.camera_size, config.projector_size
                rig = devices.enter_context(open_rig(settings, *sizes, config.projector.grid)).rig
                break
            except OverexposedError:
                exposure_us = settings.exposure_us
                if not isinstance(settings, CameraRigSettings) or exposure_us is None or exposure_us < _SHORTEST_US:
                    raise
                shorter_us = _SHORTER * exposure_us
                log.info("overexposed at %.0f µs, trying %.0f µs", exposure_us, shorter_us)
                settings = settings.model_copy(update={"exposure_us": shorter_us})
        yield rig


def device_rows(rig: Rig) -> Iterator[CheckRow]:
    """Return rows that describe the devices and the latency from projector to camera."""
    camera, projector = rig.camera.size, rig.projector.size
    yield CheckRow(
        "camera",
        Finding(
            CHECKED_DEVICES,
            Severity.NOTE,
            f"{rig.identity.get('camera', 'simulated')}, {camera[0]} × {camera[1]} pixels",
        ),
    )
    about = rig.identity.get("projector", "simulated")
    yield CheckRow(
        "projector", Finding(CHECKED_DEVICES, Severity.NOTE, f"{about}, {projector[0]} × {projector[1]} pixels")
    )
    refresh = "" if rig.refresh_hz is None else f", a refresh every {1e3 / rig.refresh_hz:.1f} ms"
    if isinstance(rig, TimedRig):
        light = f"light comes {1e3 * rig.latency_s:.0f} ms after a picture is sent"
    else:
        light = "light comes at once"
    yield CheckRow("latency", Finding(CHECKED_DEVICES, Severity.NOTE, light + refresh))


def transfer_rows(rig: Rig) -> Iterator[CheckRow]:
    """Whether the frames of the last capture came at the first attempt; nothing for rigs that lose none."""
    if not isinstance(rig, TimedRig):
        return
    taken, again = rig.tally.taken, rig.tally.retriggered
    per_frame = f"{1e3 * rig.tally.seconds_per_frame:.0f} ms per frame"
    if again <= _MANY_RETAKEN * taken:
        yield CheckRow(
            "transfer",
            Finding(CHECKED_TRANSFER, Severity.NOTE, f"{per_frame}, {again or 'none'} of {taken} taken again"),
        )
    else:
        lost = f"{per_frame}, {again} of {taken} frames were lost at first"
        yield CheckRow(
            "transfer",
            Finding(CHECKED_TRANSFER, Severity.WARNING, lost, f"{rig.lost_advice} Stop other work on this computer."),
        )
