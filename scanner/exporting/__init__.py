"""Results in the formats of other programs, in the conventions of each.

A format is a row of `FORMATS` and a module with `export(request)`.
"""

from scanner.exporting.formats import DEFAULT_GAMMA, DEFAULT_POINTS, FORMATS, Request
