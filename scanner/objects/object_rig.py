"""A rig's calibration from stations that pictures connect in part, and surfaces whole."""

import logging
from collections.abc import Sequence

from calib.finding import Finding
from calib.refusal import RefusalError
from calib.scene import FEWEST_STATIONS
from scanner.configuration import Config
from scanner.objects.solve import place_stations
from scanner.reconstruction import scaled
from scanner.results import Decoded, GivenCalibration
from scanner.rooms import after_no_corner, calibrate_by_pictures, rig_from_placed, start_of
from scanner.stations import RigStart
from scanner.ui import Progress

log = logging.getLogger(__name__)


def rig_from_object(captures: Sequence[Decoded], config: Config, progress: Progress) -> RigStart:
    """The rig by all stations of a thing: those whose pictures have points in common calibrate it well enough to place
    all by their surfaces, which calibrate it for good. Where surfaces place too few, pictures alone have to do.

    Raises RefusalError.
    """
    scene = calibrate_by_pictures(captures, config, progress, provisional=True)
    start = start_of(scene)
    if len(scene.stations) == len(captures):
        return start
    places = start.places
    try:
        by_surfaces = place_stations(captures, start, progress)
        if len(by_surfaces) > len(places):
            places = by_surfaces
    except RefusalError as refusal:
        log.info("pictures alone have to do: %s", refusal.reason)
    if len(places) == len(scene.stations) and scene.leaves_open:
        raise scene.leaves_open
    return rig_from_placed(start, {k: captures[k] for k in places}, places, config, progress)


def calibrate_without_corner(
    captures: Sequence[Decoded], config: Config, progress: Progress, no_corner: RefusalError
) -> tuple[list[GivenCalibration], tuple[Finding, ...]]:
    """Captures with their rig, by what they share, at the configured scale, and findings.

    Raises RefusalError: `no_corner` for fewer captures than that needs.
    """
    if len(captures) < FEWEST_STATIONS:
        raise no_corner
    with after_no_corner(no_corner):
        start = rig_from_object(captures, config, progress)
    calibration = scaled(start.calibration, None, config.scale)
    return [GivenCalibration(capture, calibration, start.uncertainty) for capture in captures], start.findings
