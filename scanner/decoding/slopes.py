"""Slopes of images that are those of what is between their pixels.

Taps that blur alike and differ by a derivative (Farid and Simoncelli, IEEE TIP 13, 2004, table I): the slope is that of
the blurred picture. Plain differences tell 9 % too much of a sharp edge's motion, and 10 % too much of a wave's of
eight pixels.
"""

import numpy as np

LEVEL = np.array([0.037659, 0.249153, 0.426375, 0.249153, 0.037659])
SLOPE = np.array([-0.109604, -0.276691, 0.0, 0.276691, 0.109604])
