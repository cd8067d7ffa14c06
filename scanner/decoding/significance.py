"""Limits that the decoding steps have in common: chances of error, numbers of pixels, and shares of a whole."""

from math import erfc, sqrt

# Deviations of this many sigmas are significant: chance exceeds it once in 1.7 million, about once in an image.
SIGNIFICANT_SIGMAS = 5.0
BY_CHANCE = erfc(SIGNIFICANT_SIGMAS / sqrt(2))
# Deviations of this many sigmas are outliers among a few hundred values: chance exceeds it once in 370.
OUTLYING_SIGMAS = 3.0
# Residuals larger than this many sigmas are down-weighted (Huber).
HUBER_SIGMAS = 2.0
HUBER_ROUNDS = 6  # of reweighting a linear fit
MEDIAN_ROUNDS = 20  # of reweighting that goes farther from least squares, to a median or a mode
REFITS = 3  # of a model, each from where the one before led, or without its outliers
# Difference of −2 log likelihood beyond which a hypothesis is rejected: it is a hundredth as likely (2 ln 100 = 9.2).
REJECTED = 9.0
# Quantile that represents the brightest pixels without specular reflections, and those at both ends of a distribution.
BRIGHTEST = 0.98
ENDS = (1 - BRIGHTEST, BRIGHTEST)
# With fewer pixels, cells or matches a few outliers would decide: the standard error of their median is an eighth of
# their standard deviation.
FEWEST_PIXELS = 100
# With fewer, a share of them has a standard error of a tenth.
FEWEST_COUNTED = 30
# Of this many that measure the same, one that is wrong is outvoted.
MAJORITY = 3
# A few, more than half, and nearly all of what is compared.
FEW, HALF, NEARLY_ALL = 0.1, 0.5, 0.9
# Of two explanations that explain shares of the same contradiction in this ratio, either may be the true one.
AS_GOOD = 0.8
# Smaller than all grey levels, amplitudes and powers of light that matter: it keeps a division by them finite.
NEGLIGIBLE = 1e-6
# Neighbours on a line may have this many px between them that are unlit or uncertain.
FARTHEST_PX = 16
