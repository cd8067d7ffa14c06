"""Stations that exist already: recorded captures, result folders and matches files of one unchanged rig."""

from collections.abc import Sequence
from pathlib import Path

from calib.finding import Finding
from calib.geometry import Calibration
from scanner.acquisition import decode_recording
from scanner.capture import CAPTURE_FILE, open_capture
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration, real_path
from scanner.reconstruction import find_change_in, read_captures
from scanner.results import CAPTURES_FOLDER, Decoded, read_joined, read_uncertainty
from scanner.rooms.contents import RigStart
from scanner.ui import Progress

_OF_STATIONS = (CAPTURE_FILE, MATCHES_FILE, CAPTURES_FOLDER)


def read_stations(
    paths: Sequence[Path], config: Config, progress: Progress, calibration: Calibration | None = None
) -> list[Decoded]:
    """Decode captures, and read results and matches, in the given order.

    With a `calibration`, patterns along one axis are enough. A room or a thing stands for all its stations. Raises
    InputError if a file is damaged, belongs to images of another size, or is given twice.
    """
    twice = [path for number, path in enumerate(paths) if real_path(path) in map(real_path, paths[:number])]
    if twice:
        raise InputError(f"{twice[0]}: given twice; a station counts once")
    stations: list[Decoded] = []
    for path in (station for given in paths for station in _stations_in(given)):
        if (path / CAPTURE_FILE).is_file():
            stations.append(read_recording(path, config, progress, calibration))
        else:
            one_axis = calibration is not None
            stations += read_captures([path], config.camera_size, config.projector_size, one_axis=one_axis)
    if len(stations) < 2:
        raise InputError(f"expected two stations or more, found {len(stations)}: {', '.join(map(str, paths))}")
    return stations


def _stations_in(path: Path) -> list[Path]:
    whole = read_joined(path)
    if whole is not None:
        return [station.folder for station in whole.stations]
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; a station is a recorded capture, a result or a matches.npz")
    if path.is_dir() and not any((path / name).exists() for name in _OF_STATIONS):
        raise InputError(
            f"{path}: expected a station, found none of {', '.join(_OF_STATIONS)}: give the folder of a recorded "
            "capture or of a result"
        )
    return [path]


def read_recording(path: Path, config: Config, progress: Progress, calibration: Calibration | None = None) -> Decoded:
    """A recorded capture, decoded. Raises InputError if it is of images of another size."""
    recording = open_capture(path).in_square_pixels(config.projector.grid)
    config.refuse_other_sizes(path, recording.camera_size, recording.projector_size)
    return decode_recording(recording, progress, calibration)


def given_rig(path: Path, config: Config) -> RigStart:
    """A calibration file of the rig, with its covariance if the file states one. Raises InputError."""
    given = read_calibration(path)
    config.refuse_other_sizes(path, *given.sizes)
    return RigStart(given.in_baselines, read_uncertainty(path, given), {}, given)


def find_change_of(start: RigStart, stations: Sequence[Decoded]) -> tuple[Finding, ...]:
    """A warning if the rays of stations do not meet under the calibration that was given, if one was; else ()."""
    return () if start.given is None else find_change_in(stations, start.calibration, start.uncertainty)
