"""The limit below which a quantity is poor: one rule for light and lenses.

The sigma of a match is proportional to the noise over the amplitude of the fringes, and the sigma of a calibration to
that over the root of the number of matches. A quantity is poor if it costs a factor of √2 in sigma, as much as losing
half of the frames or half of the pixels.
"""

from math import sqrt

TOLERATED_LOSS = sqrt(2.0)
# Of the amplitude of a fringe, or of the range of grey levels, so much is left then.
LEAST_AMPLITUDE = 1 / TOLERATED_LOSS
# Of the number of pixels, or of electrons, whose root sigma goes with.
LEAST_SHARE = 1 / TOLERATED_LOSS**2
