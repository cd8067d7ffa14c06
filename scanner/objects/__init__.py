"""Things: stations of one rig → its poses relative to the thing, one surface, its volume."""

from scanner.objects.contents import SolvedObject
from scanner.objects.jobs import scan_object
from scanner.objects.object_rig import calibrate_without_corner, rig_from_object
from scanner.objects.solve import advice_on, brief, outside_text, solve_object, stations_outside
from scanner.objects.surface import cloud_of, surface_of
from scanner.objects.verdict import verdict_on
