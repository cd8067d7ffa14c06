"""Spheres, faces and distances measured in the cloud of a result."""

from scanner.measuring.document import MEASURE_FILE, write_document
from scanner.measuring.figure import FIGURE_FILE, write_figure
from scanner.measuring.measure import measure
from scanner.measuring.measurements import AngleMeasurement, FaceMeasurement
from scanner.measuring.planes import measure_faces
from scanner.measuring.table import tables
