"""List cameras and screens, with the lines to paste into a configuration."""

from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from hw.cameras import CameraInfo
from hw.errors import DeviceError
from hw.open_rig import import_aravis
from hw.projector.process import list_screens
from hw.projector.screens import Screen
from scanner.ui import Terminal

_PREFERRED_FORMATS = ("Mono8", "BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8")


@dataclass(frozen=True)
class _Device:
    """How a device is called, what it can do, and the lines of a configuration that choose it."""

    name: str
    abilities: str
    rig: tuple[str, ...]
    size: str


@dataclass(frozen=True)
class Found:
    """What is `told` of cameras and of screens, the `lines` of a configuration that choose the first of each, and the
    `problems` of looking for them.
    """

    told: dict[str, list[str]]
    lines: list[str]
    problems: list[str]

    def paragraphs(self) -> Iterator[str]:
        """For a person: what there is of each."""
        for heading, told in self.told.items():
            yield "\n  ".join([heading, *(told or ["none found"])])


def run(args: Namespace) -> None:
    """Show what is there. Raises DeviceError if neither cameras nor screens can be looked for."""
    terminal = Terminal(quiet=args.quiet)
    found = find_devices(terminal)
    terminal.show(*found.paragraphs())
    if len(found.problems) == len(found.told):
        raise DeviceError("neither cameras nor screens can be listed: " + "; ".join(dict.fromkeys(found.problems)))
    if found.lines:
        terminal.show("\nTo paste into a configuration:\n", "\n".join(found.lines))
        terminal.show("\n→ scan new my-rig.yaml --rig aravis writes a whole configuration with these lines in it.")
    else:
        terminal.show("→ Connect and switch on a camera and a projector, then run scan devices again.")


def find_devices(terminal: Terminal) -> Found:
    """Look for cameras and screens."""
    problems: list[str] = []
    told: dict[str, list[str]] = {}
    found: dict[str, Sequence[_Device]] = {}
    look_for: dict[str, Callable[[], Sequence[_Device]]] = {"Cameras": _cameras, "Screens": _screens}
    for heading, look in look_for.items():
        try:
            with terminal.step(f"Looking for {heading.lower()}"):
                found[heading] = look()
            told[heading] = [line for device in found[heading] for line in (device.name, device.abilities) if line]
        except DeviceError as error:
            problems.append(str(error))
            told[heading] = [str(error)]
    cameras = [camera for camera in found.get("Cameras", ()) if camera.rig]
    # The desktop begins on the first screen; a projector is mostly the last.
    return Found(told, list(_to_paste(cameras, found.get("Screens", ())[::-1])), problems)


def _to_paste(cameras: Sequence[_Device], screens: Sequence[_Device]) -> Iterator[str]:
    """YAML that chooses the first of each; the others stand behind it as comments."""
    if not cameras and not screens:
        return
    yield "rig:"
    yield "  backend: aravis"
    for devices in (cameras, screens):
        for number, device in enumerate(devices):
            yield from (f"  {'# ' if number else ''}{line}" for line in device.rig)
    for devices in (cameras, screens):
        for number, device in enumerate(devices):
            yield f"{'# ' if number else ''}{device.size}"


def _cameras() -> list[_Device]:
    found: list[CameraInfo] = import_aravis().list_cameras()
    return [_camera(camera) for camera in found]


def _camera(camera: CameraInfo) -> _Device:
    if camera.sensor_size is None:
        unknown = "  in use by another program, or out of reach: its abilities are not known"
        return _Device(str(camera), unknown, (), "")
    width, height = camera.sensor_size
    preferred = [name for name in _PREFERRED_FORMATS if name in camera.pixel_formats]
    pixel_format = (preferred or list(camera.pixel_formats) or ["Mono8"])[0]
    return _Device(
        str(camera),
        f"  sensor {width} × {height}, formats {', '.join(camera.pixel_formats)}",
        (f'camera: "{camera.device_id}"', f"pixel_format: {pixel_format}"),
        f"camera: {{width: {width}, height: {height}}}",
    )


def _screens() -> list[_Device]:
    return [_screen(screen) for screen in list_screens()]


def _screen(screen: Screen) -> _Device:
    rate = () if screen.refresh_hz else ("refresh_hz: 60",)
    rig = (f'screen: "{screen.geometry}"', *rate)
    return _Device(str(screen), "", rig, f"projector: {{width: {screen.width}, height: {screen.height}}}")
