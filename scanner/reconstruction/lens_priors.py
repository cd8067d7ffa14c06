"""Priors of both lenses from a configuration, for every estimate."""

from calib.geometry import DeviceSigmas, Intrinsics, Size
from calib.refinement import ORDINARY_LENSES, LensPrior
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.results import CALIBRATION_FILE

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
        _told(device, sigma) if device.size == size else None
        for device, sigma, size in (
            (calibration.camera, calibration.sigma.camera, camera_size),
            (calibration.projector, calibration.sigma.projector, projector_size),
        )
    ]
    if known == [None, None]:
        raise InputError(
            f"lens.from: {file} says nothing of lenses of a camera of {camera_size} or a projector of "
            f"{projector_size}: expected a calibration with images of the same size that states the sigmas of its "
            "distortion, as of scan board"
        )
    return known[0] or camera, known[1] or projector


def _told(device: Intrinsics, sigma: DeviceSigmas) -> LensPrior | None:
    if sigma.distortion is None:
        return None
    return LensPrior(device.distortion, tuple(max(each, _SUREST) for each in sigma.distortion))
