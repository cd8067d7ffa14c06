"""What is known of the devices beforehand: lens priors of a configuration, and calibrations without captures.

A calibration of boards is combined with the captures of a corner.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from calib.geometry import DeviceSigmas, Intrinsics, Size
from calib.refinement import LensPrior
from calib.self_calibration import KnownCalibration
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration
from scanner.results import CALIBRATION_FILE, calibration_file, read_uncertainty

log = logging.getLogger(__name__)

_SUREST = 1e-6  # smallest sigma of a term


def lenses_of(config: Config, camera_size: Size, projector_size: Size) -> tuple[LensPrior, LensPrior]:
    """Return the lens priors of camera and projector with images of these sizes. Raises InputError."""
    camera, projector = "a camera", "a projector"
    lenses = lenses_by_name(config, {camera: camera_size}, {projector: projector_size})
    return lenses[camera], lenses[projector]


def lenses_by_name(config: Config, cameras: Mapping[str, Size], projectors: Mapping[str, Size]) -> dict[str, LensPrior]:
    """Return the lens priors of devices, given their image sizes; projectors' with their principal points. What the
    configuration says of one device goes before what it says of all.

    Raises InputError if a named calibration fits none of them, or does not state sigmas of its lens terms; or if a
    known principal point does not fit.
    """
    lenses = _lenses_alone(config, cameras, projectors)
    for name, size in {**cameras, **projectors}.items():
        own = config.of_device(name)
        if own.lens != config.lens:
            device = {name: size}
            lenses |= _lenses_alone(own, device if name in cameras else {}, device if name in projectors else {})
        if name in projectors:
            lenses[name] = replace(lenses[name], point=own.projector_point(size))
    return lenses


def _lenses_alone(config: Config, cameras: Mapping[str, Size], projectors: Mapping[str, Size]) -> dict[str, LensPrior]:
    setting = config.lens
    ordinary = LensPrior().with_sigmas(setting.decentering, setting.k3, setting.radial)
    lenses = dict.fromkeys([*cameras, *projectors], ordinary)
    if setting.source is None:
        return lenses
    file = calibration_file(setting.source)
    calibration = read_calibration(file)
    sigma = calibration.sigma
    known = {
        name: prior
        for sizes, device, of_device in (
            (cameras, calibration.camera, sigma.camera),
            (projectors, calibration.projector, sigma.projector),
        )
        for name, size in sizes.items()
        if device.size == size and (prior := _prior_of(device, of_device)) is not None
    }
    if not known:
        devices = " or ".join(f"{name} of {size}" for name, size in {**cameras, **projectors}.items())
        raise InputError(
            f"lens.from: {file} states no distortion with its sigmas for {devices} pixels: expected a calibration of "
            "devices with images of these sizes, by scan board for instance"
        )
    for name in lenses.keys() - known.keys():
        log.info("lens.from: %s states no lens of %s; it is taken as an ordinary one", file, name)
    return lenses | known


def _prior_of(device: Intrinsics, sigma: DeviceSigmas) -> LensPrior | None:
    if sigma.distortion is None:
        return None
    return LensPrior(
        device.distortion, tuple(max(sigma_of_term, _SUREST) for sigma_of_term in sigma.distortion), decenterings=()
    )


_YAML = (".yaml", ".yml")


def is_calibration(path: Path) -> bool:
    """Whether a path is a calibration file, or a result that has a calibration and no matches."""
    if path.is_dir():
        return (path / CALIBRATION_FILE).is_file() and not (path / MATCHES_FILE).exists()
    return path.suffix.lower() in _YAML


def read_known(paths: Sequence[Path], camera_size: Size, projector_size: Size) -> KnownCalibration | None:
    """The one calibration among these paths; None if all are captures.

    Raises InputError if there are two, or if it is of another rig, or has no covariance.
    """
    given = [path for path in paths if is_calibration(path)]
    if not given:
        return None
    if len(given) > 1:
        raise InputError(
            f"{', '.join(map(str, given))}: expected at most one calibration to join with captures; give all captures "
            "of boards to one scan board"
        )
    (path,) = given
    return _read(calibration_file(path), camera_size, projector_size)


def _read(file: Path, camera_size: Size, projector_size: Size) -> KnownCalibration:
    calibration = read_calibration(file)
    for name, device, expected in (
        ("camera", calibration.camera, camera_size),
        ("projector", calibration.projector, projector_size),
    ):
        if device.size != expected:
            raise InputError(
                f"{file}: its {name} is {device.size}, but {expected} is expected: what is calibrated together comes "
                "from one unchanged rig"
            )
    uncertainty = read_uncertainty(file, calibration)
    if uncertainty is None:
        raise InputError(
            f"{file}: has no covariance, without which it cannot be weighed against captures: make it with scan board"
        )
    return KnownCalibration(calibration, uncertainty)
