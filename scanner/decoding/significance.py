"""From when on something counts: the limits that the steps of decoding have in common."""

from math import erfc, sqrt

# What is so many standard deviations off is more than chance, which does so once in 1.7 million times.
SIGNIFICANT_SIGMAS = 5.0
BY_CHANCE = erfc(SIGNIFICANT_SIGMAS / sqrt(2))
# Where a fit meets what it does not model, residuals count less from so many standard deviations on (Huber).
HUBER_SIGMAS = 2.0
# This quantile stands for the brightest pixels, reflections aside.
BRIGHTEST = 0.98
# A few outliers among fewer pixels, cells or matches would decide what is found from them.
FEWEST_PIXELS = 100
