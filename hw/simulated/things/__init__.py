"""A thing on a turntable, or placed by hand, in front of a static background, as a scan of an object sees it.

Vectors of this folder are rows, (n, 3), in metres. The world's z is up, the table is at z = 0, and the turntable
rotates about the z axis.
"""

from hw.simulated.things.simulation import SimulatedThing, ThingRenderer, ThingTruth
from hw.simulated.things.stage import Solid, TurntableScene, draw_solid
