"""The projector's response: its brightness per grey level, and the levels to send for light proportional to a
pattern.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats

LEVELS = 256


@dataclass(frozen=True)
class ProjectorResponse:
    """`light`: at equally spaced grey levels from 0 to 255, rising from 0 (black) to 1 (white); two or more.

    Between them it is interpolated monotonically (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980).
    Raises ValueError for other values.
    """

    light: tuple[float, ...]

    def __post_init__(self) -> None:
        values = np.array(self.light)
        if len(values) < 2 or values[0] != 0 or values[-1] != 1 or not np.all(np.diff(values) > 0):
            raise ValueError("a response is two or more numbers that rise from 0 to 1")

    @cached_property
    def of_levels(self) -> Floats:
        """Light (256,) of all grey levels."""
        from scipy.interpolate import PchipInterpolator  # slow to import and rarely needed

        sampled = np.linspace(0, LEVELS - 1, len(self.light))
        return PchipInterpolator(sampled, self.light)(np.arange(LEVELS))

    @cached_property
    def compensation(self) -> NDArray[np.uint8]:
        """(256,): which level to send for each level of a pattern; black stays black and white stays white."""
        wanted = np.arange(LEVELS) / (LEVELS - 1)
        levels = np.interp(wanted, self.of_levels, np.arange(LEVELS))
        return np.rint(levels).astype(np.uint8)

    @cached_property
    def gamma(self) -> float:
        """Exponent of the closest power law, by least squares of the light."""
        # A smooth curve with one parameter needs no optimiser.
        exponents = np.linspace(0.3, 5.0, 941)
        levels = np.linspace(0, 1, len(self.light))
        misfit = np.sum((levels[None, :] ** exponents[:, None] - np.array(self.light)) ** 2, axis=1)
        return float(exponents[np.argmin(misfit)])

    @property
    def off_power_law(self) -> float:
        """The largest difference from that power law, relative to white."""
        levels = np.linspace(0, 1, len(self.light))
        return float(np.max(np.abs(levels**self.gamma - np.array(self.light))))
