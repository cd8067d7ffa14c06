"""Metadata of a recording: sizes, patterns, devices, exposures; and what frames of a film lack."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from math import hypot

from calib.geometry import Calibration, Size
from scanner.patterns import Pattern
from scanner.shown_text import shortened, shown


@dataclass(frozen=True)
class CaptureMetadata:
    """How a capture was taken; unknown values are omitted."""

    camera_size: Size
    projector_size: Size
    patterns: tuple[Pattern, ...] = ()
    identity: Mapping[str, str] = field(default_factory=dict)
    """Names of the devices, and whatever else the recording states about itself."""
    exposure_us: tuple[float, ...] = ()
    """The frames' exposures."""
    photos: bool = False
    """A camera at a second place takes the role of the projector."""
    truth: Calibration | None = None
    """Known for simulated rigs only, and only displayed."""

    @property
    def pixels(self) -> str:
        """The name of the pixels in which residuals are measured."""
        return "px" if self.photos else "projector px"

    @property
    def second(self) -> str:
        """The device whose rays meet those of the camera."""
        return "second photo" if self.photos else "projector"


_MOST_LINES, _LONGEST_LINE = 50, 200
_NOT_ABOUT_DEVICES = {"format", "projector", "camera", "frames", "devices"}


def identity(metadata: Mapping[str, object]) -> dict[str, str]:
    """What a recording says about its devices and itself, as far as it fits on a line each."""
    devices = metadata.get("devices")
    named = {str(key): value for key, value in devices.items()} if isinstance(devices, Mapping) else {}
    named |= _synchronisation(metadata.get("synchronisation"))
    of_devices = {str(key): value for key, value in metadata.items() if key not in _NOT_ABOUT_DEVICES}
    named |= {key: value for key, value in of_devices.items() if not isinstance(value, Mapping | list)}
    return {shortened(key): _line(value) for key, value in islice(named.items(), _MOST_LINES)}


def _line(value: object) -> str:
    """On a line; what others wrote may be of any kind, and of any length."""
    if isinstance(value, str):
        return shortened(value, _LONGEST_LINE)
    return shown(value) if isinstance(value, Mapping | list) else shortened(str(value), _LONGEST_LINE)


def _synchronisation(measured: object) -> dict[str, str]:
    """Return what a real rig has recorded about its acquisition, as far as it is there."""
    if not isinstance(measured, Mapping):
        return {}
    rows = {
        "latency, from a flip to its light": _with_unit(measured.get("latency_ms"), "ms"),
        "frames dropped, and taken again": measured.get("retriggered_frames"),
        "frames repeated by the camera's driver": measured.get("repeated_frames"),
        "frames that the stream dropped": measured.get("dropped_frames"),
        "frames averaged to one": measured.get("averaged_frames"),
        "time per frame": _with_unit(measured.get("ms_per_frame"), "ms"),
        "of it over exposure, and over latency where that is waited for": _with_unit(
            measured.get("overhead_percent"), "%"
        ),
        "pictures in the pipeline": measured.get("pictures_in_flight"),
        "pictures that were missed, and shown again": measured.get("missed_in_flight"),
        "frames that did not fit their neighbours, and were taken again": measured.get("doubted_frames"),
        "camera waited for the computer": _with_unit(measured.get("waited_for_computer_s"), "s"),
    }
    return {name: _line(value) for name, value in rows.items() if value is not None}


def _with_unit(value: object, unit: str) -> str | None:
    return None if value is None else f"{_line(value)} {unit}"


# As `scan import` writes it of a film; in it, by what the film's coordinates err smoothly, in projector pixels.
RECORDING_KEY, SMOOTH_KEY = "recording", "smooth_px"
# By what factor smooth errors are larger in a film that does not say by what: of codes without fringes.
_UNKNOWN = 4.0


def with_smooth_errors_of_film(smooth_px: float, metadata: Mapping[str, object]) -> float:
    """Smooth errors of a capture's coordinates that are `smooth_px` in single frames, by its metadata."""
    recording = metadata.get(RECORDING_KEY)
    if not isinstance(recording, Mapping):
        return smooth_px
    of_film = recording.get(SMOOTH_KEY)
    if isinstance(of_film, float | int) and 0 <= of_film < 1:
        return hypot(smooth_px, of_film)
    return _UNKNOWN * smooth_px
