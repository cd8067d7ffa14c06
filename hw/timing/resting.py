"""Reference frames of black and white at rest, with which later frames are compared."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Bools, Floats, Image, grey
from hw.cameras import NamedCamera
from hw.errors import DeviceError, OverexposedError
from hw.timing.complementary_sums import ComplementarySums, complementary_sums

_LEAST_TOLERANCE = 0.005  # share of the light: with a fringe of 16 px in 8 steps, a hundredth of a projector pixel
_BANDS = 8  # of the image, from top to bottom
_CLIPPED = 254 / 255  # of the highest level; demosaicing mixes clipped pixels with others


class RestingLight:
    """Finds the lit pixels and their levels, from three or more frames each of black and of white.

    `tolerance`: the smallest share of the light that exceeds noise. Raises DeviceError if the camera sees no
    difference, OverexposedError if all lit pixels are clipped.
    """

    def __init__(self, camera: NamedCamera, dark: Sequence[Image], bright: Sequence[Image]) -> None:
        self.lit = _lit_pixels(camera, dark, bright)
        levels = np.array([[self._levels(image) for image in images] for images in (dark, bright)])
        self._dark, self._bright = levels.mean(axis=1)
        noise = np.max(np.ptp(levels, axis=1) / (self._bright - self._dark))
        self.tolerance = max(_LEAST_TOLERANCE, 3.0 * float(noise))
        self.sums: ComplementarySums = complementary_sums(dark, bright, self.lit, self.tolerance)

    def missing(self, image: Image, target: int) -> Floats:
        """The missing share (B,) of the change to `target` (0 black, 1 white) in each band of rows: 1 before it
        begins, 0 at rest.
        """
        share = (self._levels(image) - self._dark) / (self._bright - self._dark)
        missing: Floats = 1 - share if target == 1 else share
        return missing

    def _levels(self, image: Image) -> Floats:
        """Mean brightness (B,) of the lit pixels in bands of rows, from top to bottom."""
        lit = grey(image)[self.lit]
        return np.array([part.mean() for part in np.array_split(lit, min(_BANDS, len(lit)))])


def _lit_pixels(camera: NamedCamera, dark: Sequence[Image], bright: Sequence[Image]) -> Bools:
    """Pixels that white lights well without clipping them, (H, W)."""
    contrast = grey(np.mean(bright, axis=0)) - grey(np.mean(dark, axis=0))
    noise = np.std(grey(dark[1]) - grey(dark[0]))
    strong = float(np.percentile(contrast, 99))
    if strong < 6 * noise or strong <= 0:
        raise DeviceError(
            f"camera {camera.name}: it sees no difference between a white and a black picture. Check lens "
            "cap, aperture and exposure, that the projector is on and shows this screen, then rerun."
        )
    clipped = np.max(bright, axis=0) >= camera.highest_level * _CLIPPED
    if clipped.ndim == 3:
        clipped = clipped.any(axis=2)
    lit: Bools = (contrast > strong / 2) & ~clipped
    if not lit.any():
        raise OverexposedError(
            f"camera {camera.name}: everything that white lights is overexposed. Close the aperture, lower "
            "the rig's gain or exposure_us, then rerun."
        )
    return lit
