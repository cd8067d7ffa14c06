"""Captures that show all of one axis before all of the other: did anything move in between?"""

from scanner.decoding.between_axes.evenly_lit import EvenlyLit, halves_of
from scanner.decoding.between_axes.measure import motion_between

__all__ = ["EvenlyLit", "halves_of", "motion_between"]
