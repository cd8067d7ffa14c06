"""List cameras and screens, with the lines to paste into a configuration."""

from argparse import Namespace

from hw.cameras import CameraInfo
from hw.errors import DeviceError
from hw.open_rig import import_aravis
from hw.projector_process import list_screens
from hw.screens import Screen
from scanner.ui import Terminal

_PREFERRED_FORMATS = ("Mono8", "BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8")


def run(args: Namespace) -> None:
    """Show what is there. Raises DeviceError if neither cameras nor screens can be looked for."""
    terminal = Terminal(quiet=args.quiet)
    problems = []
    for heading, lines in (("Cameras", _cameras), ("Screens", _screens)):
        try:
            with terminal.step(f"Looking for {heading.lower()}"):
                found = lines()
        except DeviceError as error:
            problems.append(str(error))
            found = [f"  {error}"]
        terminal.show("\n".join([heading, *(found or ["  none found"])]))
    if len(problems) == 2:
        raise DeviceError("neither cameras nor screens can be listed: " + "; ".join(problems))


def _cameras() -> list[str]:
    cameras: list[CameraInfo] = import_aravis().list_cameras()
    return [line for camera in cameras for line in _camera_lines(camera)]


def _camera_lines(camera: CameraInfo) -> list[str]:
    lines = [f"  {camera}"]
    if camera.sensor_size is None:
        return [*lines, "    in use by another program, or out of reach: its abilities are not known"]
    width, height = camera.sensor_size
    lines += [f"    sensor {width} × {height}, formats {', '.join(camera.pixel_formats)}"]
    preferred = [name for name in _PREFERRED_FORMATS if name in camera.pixel_formats]
    pixel_format = (preferred or list(camera.pixel_formats) or ["Mono8"])[0]
    lines += [f'    rig: {{backend: aravis, camera: "{camera.device_id}", pixel_format: {pixel_format}}}']
    return [*lines, f"    camera: {{width: {width}, height: {height}}}"]


def _screens() -> list[str]:
    return [line for screen in list_screens() for line in _screen_lines(screen)]


def _screen_lines(screen: Screen) -> list[str]:
    rate = "" if screen.refresh_hz else ", refresh_hz: 60"
    return [
        f"  {screen}",
        f'    rig: {{backend: aravis, screen: "{screen.geometry}"{rate}}}',
        f"    projector: {{width: {screen.width}, height: {screen.height}}}",
    ]
