"""Interreflection: the radiosity of a scene, solved once for all pictures.

Let e be the irradiance of the solving nodes by indirect light, p a picture's pyramid, and D and G the matrices of
`gather`. Then e = D p + G e contains all orders of reflection. I − G is factored once; a picture then costs one
substitution.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.spatial import cKDTree

from calib.numerics import Bools, Floats, Ints
from hw.simulated.arrays import Indices, Light
from hw.simulated.gather import Gathered
from hw.simulated.mesh import RadiosityMesh
from hw.simulated.scene import Scene


@dataclass(frozen=True)
class Interreflection:
    """Indirect irradiance at the nodes of a mesh, the solving nodes first.

    `first` maps a picture's pyramid to the light after one reflection. `exchange`, the LU factors of I − G, maps this
    light at the solving nodes to that after any number of reflections. `to_creases` maps the light of the solving nodes
    to the crease nodes. `ceiling` (nodes,): irradiance per unit of radiosity emitted by the ceiling. `stand_in`
    (nodes,): the node whose light to use at each node. It is another node where a solid covers the node, so that no
    darkness appears around the base of furniture.
    """

    first: sparse.csr_array
    exchange: tuple[Light, Ints]
    to_creases: sparse.csr_array
    ceiling: Light
    stand_in: Indices

    def irradiance(self, pyramid: Light) -> Light:
        """Irradiance (nodes,) by light that was reflected at least once, for a picture's pyramid."""
        first: Light = self.first @ pyramid
        return _exchanged(first, self.exchange, self.to_creases)


def solve(scene: Scene, mesh: RadiosityMesh, gathered: Gathered) -> Interreflection:
    """Factor the exchange of light between the nodes of a mesh."""
    count = mesh.solving_count
    stand_in = _nearest_exposed(scene, mesh, gathered.exposed)
    read = sparse.csr_array((np.ones(count, np.float32), (np.arange(count), stand_in[:count])), shape=(count, count))
    from_nodes = (gathered.from_nodes @ read).tocsr()
    exchange = linalg.lu_factor(np.eye(count, dtype=np.float32) - from_nodes[:count].toarray(), overwrite_a=True)
    to_creases = from_nodes[count:]
    ceiling = _exchanged(gathered.from_ceiling, exchange, to_creases)
    return Interreflection(gathered.from_picture, exchange, to_creases, ceiling, stand_in)


def _exchanged(first: Light, exchange: tuple[Light, Ints], to_creases: sparse.csr_array) -> Light:
    """The irradiance of all nodes, (nodes,), from their irradiance by the first reflection or emission."""
    count = len(exchange[0])
    solving = linalg.lu_solve(exchange, first[:count], check_finite=False)
    return np.concatenate([solving, first[count:] + to_creases @ solving])


def _nearest_exposed(scene: Scene, mesh: RadiosityMesh, exposed: Bools) -> Indices:
    """For each node the nearest exposed node of its kind (solving, crease) that faces the same way."""
    places = _places(scene, mesh)
    stand_in = np.arange(mesh.count)
    for first, end in ((0, mesh.solving_count), (mesh.solving_count, mesh.count)):
        candidates = first + np.flatnonzero(exposed[first:end])
        covered = first + np.flatnonzero(~exposed[first:end])
        if covered.size:
            stand_in[covered] = candidates[cKDTree(places[candidates]).query(places[covered])[1]]
    return stand_in


def _places(scene: Scene, mesh: RadiosityMesh) -> Floats:
    """Position and normal of each node, (nodes, 6). One metre counts as much as one radian."""
    places = []
    for chart in (*mesh.solving, *mesh.creases):
        uv = np.stack(np.meshgrid(chart.u, chart.v)).reshape(2, -1)
        points = scene.points_on(chart.surface, uv)
        normals = scene.normals(np.full(chart.count, chart.surface, np.int32), points)
        places.append(np.concatenate([points, normals]).T)
    return np.concatenate(places)
