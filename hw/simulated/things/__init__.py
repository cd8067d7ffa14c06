"""A thing on a turntable, or put down freely, before a background that rests: what a scanner of things looks at.

Vectors of this folder are rows, (n, 3), in metres. The world's z is up, the table is at z = 0, and the turntable turns
about the z axis.
"""

from hw.simulated.things.simulation import SimulatedThing, ThingRenderer, ThingTruth
from hw.simulated.things.solids import Solid
