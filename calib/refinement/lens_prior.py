"""What lenses are like before any match is seen: a Gaussian prior on the distortion terms of each device.

No lens has a term of exactly zero. One that is left out because matches do not show it makes the sigmas of all others
false, exactly where it is just too small to be seen; under a prior it stays as unsure as it is. docs/method.md says
where the standard deviations come from.
"""

from dataclasses import dataclass, replace

DECENTERING = 3e-4  # standard deviation of p1 and p2
THIRD_RADIAL = 0.01  # of k3
_RADIAL = 0.1, 0.03  # of k1, k2
_POWERS = 2, 4, 0, 0, 6  # k1 / f², k2 / f⁴, k3 / f⁶ are of pixels; p1 and p2 are known as the numbers that they are


@dataclass(frozen=True)
class LensPrior:
    """Of one device: `mean` and standard deviation `sigma` of k1, k2, p1, p2, k3, independent of each other.

    A sigma of 0 is for terms that a lens does not have: these stay zero.
    """

    mean: tuple[float, ...] = (0.0,) * 5
    sigma: tuple[float, ...] = (*_RADIAL, DECENTERING, DECENTERING, THIRD_RADIAL)

    @property
    def powers(self) -> tuple[int, ...]:
        """With which power of the focal length each term grows that bends the image alike; 0 for measured lenses."""
        return _POWERS if not any(self.mean) else (0,) * len(_POWERS)

    def with_sigmas(self, decentering: float | None = None, k3: float | None = None) -> "LensPrior":
        """The same with another standard deviation of p1 and p2, or of k3, where it is given."""
        k1, k2, p1, p2, third = self.sigma
        tangential = (p1, p2) if decentering is None else (decentering, decentering)
        return replace(self, sigma=(k1, k2, *tangential, third if k3 is None else k3))


ORDINARY_LENSES = LensPrior(), LensPrior()
