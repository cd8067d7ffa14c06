"""List cameras and screens, with the lines to paste into a configuration."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from calib.finding import Finding, FindingKind, Severity
from hw.backends import BACKENDS, Backend
from hw.cameras import CameraInfo
from hw.errors import DeviceError
from hw.projector import Screen, list_screens
from scanner.commands.options_of_rigs import DevicesCommand
from scanner.ui import Terminal

_ADDRESSES = "network streams cannot be listed: rig: {backend: opencv, camera: http://…} takes an address"

SEARCH_FAILED = FindingKind(
    "search-failed",
    "Cameras of a kind, or screens, could not be searched for.",
    "See what the message says about its library, and close other programs that use the devices.",
)


@dataclass(frozen=True)
class Found:
    """Cameras and screens `described` by heading, the configuration `lines` that choose the first of each, and the
    `problems` of the search. `nothing`: no camera was found, and screens cannot be listed.
    """

    described: dict[str, list[str]]
    lines: list[str]
    problems: list[Finding]
    nothing: bool

    def paragraphs(self) -> Iterator[str]:
        """Return a paragraph for each kind of device, for people."""
        for heading, described in self.described.items():
            yield "\n  ".join([heading, *(described or ["none found"])])


def run(args: DevicesCommand) -> None:
    """List the devices. Raises DeviceError if no camera was found, and screens cannot be listed."""
    terminal = Terminal(quiet=args.quiet)
    devices = find_devices(terminal)
    terminal.show(*devices.paragraphs())
    if devices.nothing:
        raise DeviceError(
            "neither cameras nor screens were found: " + "; ".join(dict.fromkeys(map(str, devices.problems)))
        )
    if devices.lines:
        terminal.show("\nTo paste into a configuration:\n", "\n".join(devices.lines))
        terminal.note("→ scan new my-rig.yaml --rig NAME writes a whole configuration with such lines in it.")
    else:
        terminal.note("→ Connect and switch on a camera and a projector, then run scan devices again.")


def find_devices(terminal: Terminal, backends: Sequence[Backend] = BACKENDS) -> Found:
    """Look for cameras that these backends reach, and for screens."""
    problems: list[Finding] = []
    cameras: list[CameraInfo] = []
    for backend in backends:
        try:
            with terminal.step(f"Looking for cameras ({backend.name})"):
                cameras += backend.load().list_cameras()
        except DeviceError as error:
            problems.append(Finding(SEARCH_FAILED, Severity.WARNING, str(error)))
    described = {"Cameras": [*(_lines_of(cameras) or ["none found"]), *map(str, problems), _ADDRESSES]}
    screens: list[CameraInfo] | None = None
    try:
        with terminal.step("Looking for screens"):
            screens = [_screen(screen) for screen in list_screens()]
        described["Screens"] = _lines_of(screens)
    except DeviceError as error:
        problems.append(Finding(SEARCH_FAILED, Severity.WARNING, str(error)))
        described["Screens"] = [str(error)]
    # The desktop is usually on the first screen, the projector on the last.
    lines = list(_to_paste([camera for camera in cameras if camera.rig], (screens or [])[::-1]))
    return Found(described, lines, problems, not cameras and screens is None)


def _lines_of(devices: Sequence[CameraInfo]) -> list[str]:
    return [line for device in devices for line in (device.name, device.about and f"  {device.about}") if line]


def _to_paste(cameras: Sequence[CameraInfo], screens: Sequence[CameraInfo]) -> Iterator[str]:
    """YAML that chooses the first of each; the others stand behind it as comments."""
    if not cameras and not screens:
        return
    yield "rig:"
    if not cameras:
        yield "  backend: aravis"
    for devices in (cameras, screens):
        for number, device in enumerate(devices):
            yield from (f"  {'# ' if number else ''}{line}" for line in device.rig)
    for key, devices in (("camera", cameras), ("projector", screens)):
        for number, device in enumerate(devices):
            if device.size:
                width, height = device.size
                yield f"{'# ' if number else ''}{key}: {{width: {width}, height: {height}}}"


def _screen(screen: Screen) -> CameraInfo:
    rate = () if screen.refresh_hz else ("refresh_hz: 60",)
    rig = (f'screen: "{screen.geometry}"', *rate)
    return CameraInfo(str(screen), "", rig, (screen.width, screen.height))
