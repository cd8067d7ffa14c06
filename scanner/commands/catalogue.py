"""Every command: its purpose, its arguments, and the module that runs it, which is imported on call."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from scanner.commands import arguments
from scanner.commands.shared_arguments import add_quiet


@dataclass(frozen=True)
class Command:
    """A command: its purpose in one line and in detail; `add_arguments` declares its arguments; `module` has
    `run(args)`.
    """

    about: str
    add_arguments: Callable[[ArgumentParser], None]
    module: str
    more: str = ""

    def load(self) -> Callable[[Namespace], None]:
        """Import the function that does the work; it raises InputError, StorageError, DeviceError, RefusalError."""
        run: Callable[[Namespace], None] = import_module(f"scanner.commands.{self.module}").run
        return run


MAIN = Command("Scan with the configured rig: capture, calibrate, reconstruct.", arguments.of_scan, "scan")
NAMED = {
    "replay": Command("Reconstruct from a recorded capture, also of another program.", arguments.of_replay, "replay"),
    "calibrate": Command(
        "Calibrate from matches of another decoder or of earlier results: one capture, or several of one rig at once.",
        arguments.of_calibrate,
        "calibrate",
    ),
    "batch": Command(
        "Reconstruct many captures, on one machine or many, into one table.",
        arguments.of_batch,
        "batch",
        """
A refusal or a crash is noted in the capture's row; the others go on. After an interruption, repeat the command: only
what is left is done. Sources and --out may be remote, as in s3://bucket/folder.
""",
    ),
    "patterns": Command(
        "Write the patterns as images, with a sequence.yaml that describes them, to be projected by any other means.",
        arguments.of_patterns,
        "patterns",
    ),
    "new": Command(
        "Write a commented configuration, with the devices that are found filled in.",
        arguments.of_new,
        "new",
    ),
    "devices": Command("List cameras and screens, with the lines to paste into a configuration.", add_quiet, "devices"),
    "check": Command(
        "Check the rig before a scan: devices, exposure, light, focus, and how well this view will calibrate.",
        arguments.of_check,
        "check",
        """
Each line says what was found and, after an arrow, what to do. --write puts the exposure (a whole number of the
projector's refresh periods in which nothing saturates) and the projector's response into the configuration file; only
these lines change, and the original file is kept as FILE.bak.

Exit codes: 0 if a scan would work, even if poorly; 3 if a device fails; 4 if a scan of this view would be refused. The
results so far are always shown.
""",
    ),
    "export": Command("Write a result in another program's format and conventions.", arguments.of_export, "export"),
    "measure": Command(
        "Measure in a result: the form of a ball, the flatness of the faces, and distances between points.",
        arguments.of_measure,
        "measure",
        """
The faces are always measured. --sphere finds a ball of known diameter anywhere in the cloud; given twice, it finds two,
and measures the distance of their centres, too.
""",
    ),
    "accept": Command(
        "Test the scanner with a calibrated ball bar, after VDI/VDE 2634 part 2.",
        arguments.of_accept,
        "accept",
        """
Probing, sphere-spacing and flatness errors. Scan the ball bar in several places, with the rig unchanged, and give all
the results: the largest errors count.
""",
    ),
    "view": Command("Look at a result in 3-D, in the browser.", arguments.of_view, "view"),
    "console": Command("Check, scan and look at results on a page in the browser.", arguments.of_console, "console"),
    "photos": Command(
        "Calibrate an ordinary camera from two or more photos of a corner, and reconstruct what they share.",
        arguments.of_photos,
        "photos",
        """
The photos may be cropped if all are cropped alike, because the principal point is estimated, too. The zoom must not
change between them. The result is that of the first two photos.
""",
    ),
    "board": Command(
        "Calibrate from captures of a printed board in different poses, and say how accurate that is.",
        arguments.of_board,
        "board",
        """
Take six to ten captures, at least three. Tilt the board by 20 to 45 degrees to either side and up and down, at
different distances, so that together the captures fill both pictures. Move nothing but the board.

Exit codes: 2 if the board is not found; 4 if these boards do not determine a calibration, with the reason.
""",
    ),
    "room": Command(
        "Join stations of one unchanged rig into a room: their poses, the walls, one cloud, a floor plan.",
        arguments.of_room,
        "room",
        """
Each station should see about a third of what another one saw, and one at least a corner of the room. Stations of
another room, or of a rig that was changed, are named and left out. To take stations: scan --config FILE --stations N.

Exit codes: 4 if no two stations belong together, or if they fit together in more than one way, with both answers.
""",
    ),
    "network": Command(
        "Calibrate several cameras and projectors of one room together: every device, one cloud from all cameras.",
        arguments.of_network,
        "network",
        """
Each capture is of one camera in one projector's light, in a folder named <camera>-<projector>. One pair sees a corner
of the room; the others follow where a camera sees two projectors' light, or a projector's light is seen by two cameras.

Exit codes: 4 if no corner calibrates a pair, a device does not connect, or the cameras contradict each other.
""",
    ),
    "object": Command(
        "Join stations of a thing seen by one calibrated rig: their poses, one surface, its volume.",
        arguments.of_object,
        "object",
        """
The rig is fixed, and the thing is turned between stations, on a turntable or by hand. Successive stations should
overlap by half. The static background, such as table and wall, is recognised and left out. To take stations: scan
--config FILE --object --stations N --calibration FILE.

Exit codes: 4 if no two stations belong together, if nothing was turned, if the calibration is of another rig, or if a
rotation is ambiguous, as for a ball.
""",
    ),
    "live": Command(
        "Show live clouds of a calibrated rig; kept ones become stations of a thing or a room.",
        arguments.of_live,
        "live",
        """
Six frames make a cloud: two fringes of three steps along one axis. What moves too fast is left out, and counted. Enter
keeps a cloud; scan object OUT or scan room OUT joins them. Ctrl-C ends; kept clouds stay.
""",
    ),
    "compare": Command(
        "Compare two calibrations of one rig: where they differ, and whether their sigmas allow it.",
        arguments.of_compare,
        "compare",
        """
Differences are in projector pixels and as lengths, over the camera's picture and by depth, after the best rigid
alignment. The exit code is 0 even if the calibrations differ: the last sentence says whether they do.
""",
    ),
    "import": Command(
        "Make a capture from another program's frames, recognising their order.", arguments.of_import, "import_"
    ),
}
