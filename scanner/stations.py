"""Stations of one unchanged rig, in a room or before a thing: taken now, or recorded before; and the rig itself."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copy2

from calib.diagnostics import Uncertainty
from calib.finding import Finding
from calib.geometry import Calibration, Pose
from hw.open_rig import at_place, moves_by_itself
from scanner.acquisition import decode_recording, take
from scanner.capture import CAPTURE_FILE, check_places, open_capture
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration, real_path, write_matches
from scanner.reconstruction import find_change_in, lenses_of, read_captures
from scanner.results import CAPTURES_FOLDER, TRUTH_FILE, Decoded, read_joined, read_uncertainty
from scanner.ui import Progress, Terminal

_OF_STATIONS = (CAPTURE_FILE, MATCHES_FILE, CAPTURES_FOLDER)


@dataclass(frozen=True, eq=False)
class RigStart:
    """The rig before its room is estimated, in baselines."""

    calibration: Calibration
    uncertainty: Uncertainty | None
    """None if a given calibration states none."""
    corners: Mapping[int, Decoded]
    """The stations from whose corners it was calibrated, by number, with their faces; empty if the calibration was
    `given`, in its own unit, or is by what stations share.
    """
    given: Calibration | None = None
    findings: tuple[Finding, ...] = ()
    """What is worth knowing of it."""
    places: Mapping[int, Pose] = field(default_factory=dict)
    """Of stations that calibrated it, by number, nearly known: X_any = R X_station + t."""


def given_rig(path: Path, config: Config) -> RigStart:
    """A calibration file of the rig, with its covariance if the file states one. Raises InputError."""
    given = read_calibration(path)
    config.refuse_other_sizes(path, *given.sizes)
    return RigStart(given.in_baselines, read_uncertainty(path, given), {}, given)


def find_change_of(start: RigStart, stations: Sequence[Decoded]) -> tuple[Finding, ...]:
    """A warning if the rays of stations do not meet under the calibration that was given, if one was; else ()."""
    return () if start.given is None else find_change_in(stations, start.calibration, start.uncertainty)


def check_stations(config: Config, number: int, terminal: Terminal) -> None:
    """Raise InputError if the rig does not have this many poses, nobody can be asked to move it, or a file of the
    calibration is invalid.
    """
    if number < 2:
        raise InputError(f"--stations: expected 2 or more, found {number}")
    lenses_of(config, config.camera_size, config.projector_size)
    check_places(config.required_rig, number, terminal, option="--stations", joined="scan room")


def take_stations(
    config: Config, number: int, folder: Path, terminal: Terminal, what_to_do: str = "Move the rig as a whole"
) -> Iterator[Decoded]:
    """Each station as it is captured, or fewer if the operator ends: between them the operator is asked, unless the rig
    moves by itself. Raises DeviceError.
    """
    for step in range(number):
        done = f"Station {step} of {number} is done. {what_to_do}"
        if step and not moves_by_itself(config.required_rig) and not terminal.ready(done):
            return
        place = folder / CAPTURES_FOLDER / str(step + 1)
        place.mkdir(parents=True)
        capture = take(at_place(config.required_rig, step), config, place, terminal, f"Station {step + 1}")
        write_matches(place / MATCHES_FILE, capture.matches)  # should a later station fail
        if (place / TRUTH_FILE).is_file() and step == 0:
            copy2(place / TRUTH_FILE, folder / TRUTH_FILE)
        yield capture


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
