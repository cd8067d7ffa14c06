"""Significance limits that the decoding steps have in common."""

from math import erfc, sqrt

# Deviations of this many sigmas are significant: chance exceeds it once in 1.7 million.
SIGNIFICANT_SIGMAS = 5.0
BY_CHANCE = erfc(SIGNIFICANT_SIGMAS / sqrt(2))
# Residuals larger than this many sigmas are down-weighted (Huber).
HUBER_SIGMAS = 2.0
# Quantile that represents the brightest pixels without specular reflections.
BRIGHTEST = 0.98
# With fewer pixels, cells or matches a few outliers would decide the result.
FEWEST_PIXELS = 100
