"""Two calibration files → where they differ."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from calib.diagnostics import Difference, SystematicErrors, Uncertainty, compare
from calib.geometry import Calibration, Matches, Size, intersect
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration, read_matches, refuse_other_sizes
from scanner.measuring import rig_errors
from scanner.quantities import UNKNOWN_UNIT, metres_per, parse_length
from scanner.results import calibration_file, read_uncertainty

_COLUMNS = 16
_MOST_MATCHES = 20_000
_QUANTILES = (0.1, 0.5, 0.9)  # of a scene's depths
_AROUND, _USUAL_BASELINES = (0.7, 1.0, 1.4), 6.0
_PLAUSIBLE_BASELINES = (2.0, 40.0)


@dataclass(frozen=True, eq=False)
class NamedCalibration:
    """A calibration to compare with another."""

    name: str
    """What it is called."""
    calibration: Calibration
    uncertainty: Uncertainty | None
    """Its covariance, if it states one."""
    matches: Callable[[], Matches | None]
    """Those of its scene, if it has one."""

    @property
    def errors(self) -> SystematicErrors:
        """Of its rig. Raises InputError if its unit is no unit of length."""
        if self.calibration.unit != UNKNOWN_UNIT:
            metres_per(self.calibration.unit)
        return rig_errors(self.calibration, self.uncertainty)


@dataclass(frozen=True)
class Sheet:
    """One depth of a comparison; all arrays are (H, W) over the camera's picture, NaN outside the common field of
    view.
    """

    depth: float
    length: Floats
    length_sigma: Floats
    px: Floats
    px_sigma: Floats


@dataclass(frozen=True)
class CalibrationComparison:
    """`names` as they were given; `known`: whether each says its covariance; `camera_px` (H, W, 2): the grid.

    Lengths are in `unit`. `difference` is over all points, `sheets` are the same by depth.
    """

    names: tuple[str, str]
    known: tuple[bool, bool]
    unit: str
    metric: bool
    camera_size: Size
    camera_px: Floats
    difference: Difference
    sheets: tuple[Sheet, ...]


def compare_files(first: Path, second: Path, depths: Sequence[str] = ()) -> CalibrationComparison:
    """Compare files or result folders as `compare_calibrations` does. Raises InputError."""
    return compare_calibrations(_read(first), _read(second), depths)


def compare_calibrations(
    first: NamedCalibration, second: NamedCalibration, depths: Sequence[str] = ()
) -> CalibrationComparison:
    """Compare two calibrations; `depths` are lengths as text, by default some of the first one's scene.

    Lengths are in the first one's unit; if only the second one has a known length, it comes first. Raises InputError.
    """
    if first.calibration.unit == UNKNOWN_UNIT != second.calibration.unit:
        first, second = second, first
    sizes = second.calibration.sizes, first.calibration.sizes
    refuse_other_sizes(second.name, *sizes, f"that of {first.name}", ": these are two rigs")
    both = f"{first.name} and {second.name}"
    of_first, of_second = first.errors, second.errors
    units = [of_first.calibration.unit, of_second.calibration.unit]
    metric = UNKNOWN_UNIT not in units
    if metric:
        of_second = _in_unit(of_second, metres_per(units[1]) / metres_per(units[0]), units[0])
    grid = _grid(of_first.calibration.camera.size)
    at = np.array([parse_length(text, units[0]) for text in depths]) if depths else _depths(first)
    try:
        difference = compare(of_first, of_second, grid.reshape(-1, 2), at, metric=metric)
    except ValueError as error:
        raise InputError(
            f"{both} cannot be compared: {error}; expected standard deviations that a rig can have"
        ) from error
    if difference is None:
        raise InputError(
            f"{both} see next to nothing in common at depths of {', '.join(f'{d:.3g}' for d in at)} "
            f"{units[0]}: they are not of one rig, or --depths is far from where both devices see"
        )
    return CalibrationComparison(
        (first.name, second.name),
        (of_first.known, of_second.known),
        units[0],
        metric,
        of_first.calibration.camera.size,
        grid,
        difference,
        tuple(_sheet(difference, float(depth), grid) for depth in at),
    )


def _read(path: Path) -> NamedCalibration:
    file = calibration_file(path)
    calibration = read_calibration(file)
    matches = partial(read_matches, path) if (path / MATCHES_FILE).is_file() else lambda: None
    return NamedCalibration(str(path), calibration, read_uncertainty(file, calibration), matches)


def _in_unit(errors: SystematicErrors, factor: float, unit: str) -> SystematicErrors:
    calibration = errors.calibration
    return SystematicErrors(
        calibration.scaled(factor, unit),
        errors.uncertainty,
        errors.log_scale,
    )


def _grid(size: Size) -> Floats:
    """Middles of squares that cover the camera's picture, (H, W, 2)."""
    side = size.width / _COLUMNS
    rows = max(1, round(size.height / side))
    x, y = ((np.arange(n) + 0.5) / n * length - 0.5 for n, length in ((_COLUMNS, size.width), (rows, size.height)))
    return np.stack(np.meshgrid(x, y), axis=-1)


def _depths(of: NamedCalibration) -> Floats:
    """Return the depths of the scene where there is one; else depths around the intersection of the two centre rays."""
    calibration, matches = of.calibration, of.matches()
    if matches is not None:
        met = intersect(matches[:: max(1, len(matches) // _MOST_MATCHES)], calibration)
        if met.in_front.any():
            scene: Floats = np.quantile(met.points[met.in_front, 2], _QUANTILES)
            return scene
    devices = calibration.camera, calibration.projector
    middles = [np.array([[(device.width - 1) / 2, (device.height - 1) / 2]]) for device in devices]
    depth = float(intersect(Matches(middles[0], middles[1]), calibration).points[0, 2])
    low, high = (times * calibration.baseline for times in _PLAUSIBLE_BASELINES)
    if not low < depth < high:
        depth = _USUAL_BASELINES * calibration.baseline
    return depth * np.array(_AROUND)


def _sheet(difference: Difference, depth: float, grid: Floats) -> Sheet:
    here = np.flatnonzero(difference.depth == depth)
    # No two pixels of the grid correlate.
    place = {tuple(pixel): i for i, pixel in enumerate(grid.reshape(-1, 2).tolist())}
    index = [place[tuple(pixel)] for pixel in difference.camera_px[here].tolist()]

    def over(values: Floats) -> Floats:
        filled = np.full(grid.shape[0] * grid.shape[1], np.nan)
        filled[index] = values[here]
        return filled.reshape(grid.shape[:2])

    return Sheet(
        depth, over(difference.length), over(difference.length_sigma), over(difference.px), over(difference.px_sigma)
    )
