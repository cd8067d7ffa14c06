"""Priors of both lenses from a configuration, for every estimate."""

import logging

from calib.geometry import DeviceSigmas, Intrinsics, Size
from calib.refinement import ORDINARY_LENSES, LensPrior
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.results import CALIBRATION_FILE

log = logging.getLogger(__name__)

_SUREST = 1e-6  # nothing is known better of a term


def lenses_of(config: Config, camera_size: Size, projector_size: Size) -> tuple[LensPrior, LensPrior]:
    """Return the lens priors of camera and projector with images of these sizes.

    Raises InputError if a named calibration belongs to neither device, or does not state the uncertainty of its lens
    terms.
    """
    setting = config.lens
    camera, projector = ORDINARY_LENSES
    if setting.source is None:
        return camera.with_sigmas(setting.decentering, setting.k3), projector.with_sigmas(
            setting.decentering, setting.k3
        )
    file = setting.source / CALIBRATION_FILE if setting.source.is_dir() else setting.source
    calibration = read_calibration(file)
    known = [
        _prior_of(device, sigma) if device.size == size else None
        for device, sigma, size in (
            (calibration.camera, calibration.sigma.camera, camera_size),
            (calibration.projector, calibration.sigma.projector, projector_size),
        )
    ]
    if known == [None, None]:
        raise InputError(
            f"lens.from: {file} states no distortion with its sigmas for a camera of {camera_size} or a projector of "
            f"{projector_size} pixels: expected a calibration of devices with images of these sizes, by scan board for "
            "instance"
        )
    for name, prior, size in zip(("camera", "projector"), known, (camera_size, projector_size), strict=True):
        if prior is None:
            log.info("lens.from: %s states no lens of a %s of %s; it is taken as an ordinary one", file, name, size)
    return known[0] or camera, known[1] or projector


def _prior_of(device: Intrinsics, sigma: DeviceSigmas) -> LensPrior | None:
    if sigma.distortion is None:
        return None
    return LensPrior(device.distortion, tuple(max(each, _SUREST) for each in sigma.distortion))
