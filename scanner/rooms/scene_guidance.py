"""Between stations that show no corner: what the newest determine, and which next one would help most."""

from collections.abc import Sequence
from typing import Literal

from calib.refusal import RefusalError
from calib.scene import FEWEST_STATIONS, NextStation
from scanner.configuration import Config
from scanner.quantities import relative_focal_sigmas
from scanner.results import Decoded
from scanner.rooms.scene_rig import calibrate_by_pictures
from scanner.ui import Progress

Moved = Literal["object", "rig"]
"""What is turned or moved between stations."""

_NEWEST = 4  # stations that are compared
_ANY = {
    "object": "turn or tip the object by 10 to 30°, each time about another axis",
    "rig": "move the rig round the scene by 10 to 30° and roll it once, with the same things in the picture",
}
# By the axis about which the scene turns and its sign, as of `NextStation`. A rig moves the other way round.
_TURNS = {
    "object": {
        (0, True): "tip the object by {:.0f}°, its top towards the camera",
        (0, False): "tip the object by {:.0f}°, its top away from the camera",
        (1, True): "turn the object by {:.0f}°, its front to the left as the camera sees it",
        (1, False): "turn the object by {:.0f}°, its front to the right as the camera sees it",
        (2, True): "tip the object sideways by {:.0f}°, clockwise as the camera sees it",
        (2, False): "tip the object sideways by {:.0f}°, anticlockwise as the camera sees it",
    },
    "rig": {
        (0, True): "raise the rig and look down on the scene by {:.0f}° more",
        (0, False): "lower the rig and look up at the scene by {:.0f}° more",
        (1, True): "go round the scene to the right by {:.0f}°",
        (1, False): "go round the scene to the left by {:.0f}°",
        (2, True): "roll the rig by {:.0f}°, its left side down",
        (2, False): "roll the rig by {:.0f}°, its right side down",
    },
}


def guide_without_corner(captures: Sequence[Decoded], config: Config, progress: Progress, moved: Moved) -> str:
    """Sentences about the stations so far, for an operator who takes a further one."""
    missing = FEWEST_STATIONS - len(captures)
    if missing > 0:
        more = "One more station calibrates" if missing == 1 else f"{missing} more stations calibrate"
        return f"{more} the rig. Next: {_ANY[moved]}."
    newest = captures[-_NEWEST:]
    try:
        scene = calibrate_by_pictures(newest, config, progress)
    except RefusalError as refusal:
        return f"The last {len(newest)} stations do not calibrate the rig yet. {refusal.reason} {refusal.advice}"
    if len(newest) - 1 not in scene.stations:
        return f"{newest[-1].name} shares too few points with those before it. Next: turn by less, 10 to 20°."
    known = 100 * max(relative_focal_sigmas(scene.calibration).values())
    sentence = f"The last {len(newest)} stations determine the focal lengths to ± {known:.2g} %."
    return f"{sentence} {_next(scene.next_station(), moved)}"


def _next(best: NextStation | None, moved: Moved) -> str:
    if best is None:
        return f"Next: {_ANY[moved]}."
    turn = _TURNS[moved][best.axis, best.turn_deg > 0].format(abs(best.turn_deg))
    percent = 100 * max(best.camera_focal, best.projector_focal)
    return f"Most would help: {turn}; then ± {percent:.2g} %."
