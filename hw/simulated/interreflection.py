"""Interreflection: the radiosity of a scene, solved once for all pictures.

Let e be the irradiance of the solving nodes by indirect light, p a picture's pyramid, and D and G the matrices of
`gather`. Then e = D p + G e contains all orders of reflection. I − G is factored once; a picture then costs one
substitution.

The sources of the light that reaches each node, found by casting rays from the node.

Each node casts rays from its whole support, in directions distributed with the cosine to the normal. Every ray then
carries the same share of the irradiance: the form factor to a surface is the share of rays that hit it (Malley's
method; Cohen and Wallace, Radiosity and Realistic Image Synthesis, 1993, section 4.3). In a closed room the shares sum
to one, so energy is conserved for any number of rays.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.spatial import cKDTree

from calib.numerics import Bools, Floats, Ints, in_parallel
from hw.simulated.arrays import Indices, Light, sparse_matrix
from hw.simulated.illumination import ProjectorLight
from hw.simulated.mesh import RadiosityMesh
from hw.simulated.picture import PictureOptics
from hw.simulated.scene import Scene
from hw.simulated.texture import Texture

_BATCH_RAYS = 1 << 15  # small enough for the arrays to stay in cache
# A ray averages the picture over this multiple of the width of its part of the hemisphere. Overlapping footprints
# prevent aliasing of fringes that should cancel. They blur a kernel of ninety degrees by about ten.
_WIDENING = 3.0
_LIFT_M = 1e-4  # distance of the start of a ray from its surface
CEILING = 5  # the ceiling's number among the surfaces


@dataclass(frozen=True)
class Gathered:
    """Linear maps to the irradiance of nodes, one row per node."""

    from_picture: sparse.csr_array
    """From a picture's pyramid, over one diffuse reflection."""
    from_nodes: sparse.csr_array
    """From the irradiance of the solving nodes, over one reflection."""
    from_ceiling: Light
    """Irradiance per unit of radiosity emitted by the ceiling, (n,)."""
    exposed: Bools
    """Nodes that are not covered by a solid; the rows of others are zero, (n,)."""


@dataclass(frozen=True)
class Gatherer:
    """Casts the rays of nodes and looks up the light where they hit."""

    light: ProjectorLight
    texture: Texture
    picture: PictureOptics
    mesh: RadiosityMesh

    def gather(self, rays: int, rng: np.random.Generator) -> Gathered:
        """The light of all nodes of the mesh, with `rays` rays per node."""
        charts = (*self.mesh.solving, *self.mesh.creases)
        surface = np.concatenate([np.full(chart.count, chart.surface, np.int32) for chart in charts])
        support = np.concatenate([chart.support() for chart in charts])
        shifts = rng.random((surface.size, 4))
        batches = np.array_split(np.arange(surface.size), max(1, surface.size * rays // _BATCH_RAYS))
        parts = in_parallel(lambda nodes: self._batch(surface[nodes], support[nodes], shifts[nodes], rays), batches)
        return Gathered(
            sparse.vstack([part.from_picture for part in parts], format="csr"),
            sparse.vstack([part.from_nodes for part in parts], format="csr"),
            np.concatenate([part.from_ceiling for part in parts]),
            np.concatenate([part.exposed for part in parts]),
        )

    def _batch(self, surface: Ints, support: Floats, shifts: Floats, rays: int) -> Gathered:
        scene = self.light.scene
        origins, directions = self._rays(surface, support, shifts, rays)
        node = np.repeat(np.arange(surface.size), rays)
        free = np.flatnonzero(scene.is_free(origins))
        origins, directions, node = origins[:, free], directions[:, free], node[free]
        per_node = np.bincount(node, minlength=surface.size)
        # A node counts as exposed only if enough of its rays start in free space.
        exposed = per_node > rays / 8
        share = np.where(exposed, 1 / np.maximum(per_node, 1), 0.0)[node]

        t, met = scene.cast(origins, directions)
        points = origins + t * directions
        uv = scene.surface_coordinates(met, points)
        reflected = share * self.texture.albedo(met, uv)

        nodes, weights = self.mesh.interpolate_solving(met, uv)
        texels, irradiance = self._direct(met, points, np.pi * t**2 / rays)
        lit = np.flatnonzero(irradiance)
        count = surface.size
        return Gathered(
            sparse_matrix(
                node[lit], texels[lit, None], (reflected * irradiance)[lit, None], (count, self.picture.texel_count)
            ),
            self._between_nodes(node, nodes, weights * reflected[:, None], count),
            np.bincount(node, share * (met == CEILING), count).astype(np.float32),
            exposed,
        )

    def _between_nodes(self, node: Indices, nodes: Indices, weights: Floats, count: int) -> sparse.csr_array:
        """Like `sparse_matrix`, by way of a full one: the rays of a node meet most solving nodes many times."""
        solving = self.mesh.solving_count
        place = node[:, None] * solving + nodes
        full = np.bincount(place.ravel(), weights.ravel(), count * solving).astype(np.float32)
        return sparse.csr_array(full.reshape(count, solving))

    def _rays(self, surface: Ints, support: Floats, shifts: Floats, rays: int) -> tuple[Floats, Floats]:
        """Origins and unit directions (3, nodes · rays), node by node."""
        scene = self.light.scene
        samples = (shifts[:, None, :] + _low_discrepancy(rays)) % 1.0
        low, high = support[:, None, 0], support[:, None, 1]
        uv = (low + samples[..., :2] * (high - low)).reshape(-1, 2).T
        repeated = np.repeat(surface, rays)
        origins = np.empty((3, repeated.size))
        for number in np.unique(surface):
            here = np.flatnonzero(repeated == number)
            origins[:, here] = scene.points_on(int(number), uv[:, here])
        normals = scene.normals(repeated, origins)
        return origins + _LIFT_M * normals, _cosine_distributed(normals, samples[..., 2:].reshape(-1, 2).T)

    def _direct(self, surface: Ints, points: Floats, area_m2: Floats) -> tuple[Indices, Floats]:
        """Irradiance (n,) by the picture at points (3, n), and the texels (n,) that average it over areas (n,).

        The areas are perpendicular to the rays. Slant at either end enlarges them by less than the widening factor.
        """
        optics = self.light.projector.optics
        pixels, irradiance = self.light.direct(surface, points)
        irradiance[~optics.sees(pixels)] = 0.0
        texels = np.zeros(irradiance.size, np.int64)
        lit = np.flatnonzero(irradiance)
        footprint_px = _WIDENING * optics.focal_px * np.sqrt(area_m2[lit] * irradiance[lit])
        texels[lit] = self.picture.texels(pixels[:, lit], footprint_px)
        return texels, irradiance


def _cosine_distributed(normals: Floats, uniform: Floats) -> Floats:
    """Unit directions (3, n) about unit normals (3, n) from uniform numbers (2, n): Malley's method."""
    steep = np.abs(normals[2]) > 0.9
    aside = np.where(steep, np.array([[1.0], [0.0], [0.0]]), np.array([[0.0], [0.0], [1.0]]))
    tangent = np.cross(normals, aside, axis=0)
    tangent /= np.linalg.norm(tangent, axis=0)
    radius, angle = np.sqrt(uniform[0]), 2 * np.pi * uniform[1]
    directions: Floats = (
        radius * np.cos(angle) * tangent
        + radius * np.sin(angle) * np.cross(normals, tangent, axis=0)
        + np.sqrt(1 - uniform[0]) * normals
    )
    return directions


def _low_discrepancy(count: int) -> Floats:
    """Evenly spread samples, (count, 4) in [0, 1): two for the position in the node's support, two for the direction.

    Directions form a Fibonacci lattice. Positions are the R2 sequence of Roberts (2018), with the root of x³ = x + 1.
    """
    plastic, golden = 1.324717957244746, 1.618033988749895
    k = np.arange(count)
    return np.stack([k / plastic % 1, k / plastic**2 % 1, (k + 0.5) / count, k / golden % 1], axis=1)


@dataclass(frozen=True)
class Interreflection:
    """Indirect irradiance at the nodes of a mesh, the solving nodes first."""

    first: sparse.csr_array
    """Maps a picture's pyramid to the light after one reflection."""
    exchange: tuple[Light, Ints]
    """The LU factors of I − G; map this light at the solving nodes to that after any number of reflections."""
    to_creases: sparse.csr_array
    """Maps the light of the solving nodes to the crease nodes."""
    ceiling: Light
    """Irradiance per unit of radiosity emitted by the ceiling, (nodes,)."""
    stand_in: Indices
    """The node whose light to use at each node, (nodes,). It is another node where a solid covers the node, so that no
    darkness appears around the base of furniture.
    """

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
