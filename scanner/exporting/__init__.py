"""Results in the formats of other programs, in the conventions of each."""

from scanner.exporting.colmap import DEFAULT_POINTS
from scanner.exporting.formats import FORMATS, Request
