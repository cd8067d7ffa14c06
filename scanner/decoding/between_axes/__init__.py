"""Motion between the axes, in captures that show all patterns of one axis before all of the other."""

from scanner.decoding.between_axes.measure import halves_of, motion_between
