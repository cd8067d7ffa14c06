"""Gaussian priors on the distortion terms of each device.

No distortion term is exactly zero. Omitting a term that is just too small to detect makes the sigmas of all other
parameters wrong; with a prior, its uncertainty is kept. docs/method.md gives the origin of the standard deviations.
"""

from dataclasses import dataclass, replace

DECENTERING = 3e-4  # standard deviation of p1 and p2
THIRD_RADIAL = 0.01  # of k3
_RADIAL = 0.1, 0.03  # of k1, k2
_POWERS = 2, 4, 0, 0, 6  # the image depends on k1 / f², k2 / f⁴, k3 / f⁶; the prior on p1 and p2 is on the numbers


@dataclass(frozen=True)
class LensPrior:
    """Prior of one device: `mean` and standard deviation `sigma` of k1, k2, p1, p2, k3, all independent.

    A sigma of 0 marks terms that a lens does not have: these stay zero.
    """

    mean: tuple[float, ...] = (0.0,) * 5
    sigma: tuple[float, ...] = (*_RADIAL, DECENTERING, DECENTERING, THIRD_RADIAL)

    @property
    def powers(self) -> tuple[int, ...]:
        """Power of the focal length with which each term scales at equal image distortion; 0 for measured lenses."""
        return _POWERS if not any(self.mean) else (0,) * len(_POWERS)

    def with_sigmas(self, decentering: float | None = None, k3: float | None = None) -> "LensPrior":
        """Return a copy with another standard deviation of p1 and p2, or of k3, where given."""
        k1, k2, p1, p2, third = self.sigma
        tangential = (p1, p2) if decentering is None else (decentering, decentering)
        return replace(self, sigma=(k1, k2, *tangential, third if k3 is None else k3))


ORDINARY_LENSES = LensPrior(), LensPrior()
