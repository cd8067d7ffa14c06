"""A plane lit by one projector and seen by one camera, and what such pairs have in common in the image of a device."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from calib.estimation import Cells, Problem
from calib.geometry import PER_PLANE, Matches, Plane, Pose, Size, dot, tangent_basis, unproject
from calib.networks.network import PER_NODE, Device, DeviceNumbers, Network, pixels_into, rays_into
from calib.networks.raster import ImageRaster, SeenAt, depths
from calib.networks.shared_points import SharedPoints, shared_points
from calib.numerics import Bools, Floats, Ints, compiled

PER_SIGHT = 2 * PER_NODE + PER_PLANE


@dataclass(frozen=True, eq=False)
class PlaneObservation:
    """The `cells` of one plane that `camera` sees in the light of `projector`; all by number in the network.

    `capture`: number of the pair.
    """

    capture: int
    camera: int
    projector: int
    plane: int
    cells: Cells

    def columns(self, network: Network) -> Ints:
        """The network's columns that it depends on, (39,): the camera's, the projector's, the plane's."""
        every = np.arange(network.size, dtype=np.int32)
        return np.concatenate(
            [
                every[network.device_columns(self.camera)],
                every[network.device_columns(self.projector)],
                every[network.plane_columns(self.plane)],
            ]
        )

    def carried(self, _: Network) -> Floats:
        """Its own columns are those of the network, (39, 39)."""
        return np.eye(PER_SIGHT)

    def points(self, network: Network) -> Floats:
        """Where the rays of its cells meet the plane, (M, 3) in the network's frame."""
        camera = network.devices[self.camera]
        return points_on(self.cells.camera_px, camera, network.planes[self.plane])

    def predict(self, network: Network, camera_px: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Projector pixels (N, 2) of its cells, or of `camera_px`, their Jacobian (N, 2, 39), and depths (N, 2).

        A point stays on the plane: moved by v it slides back along its ray u, n · u = 1, by u (n · v).
        """
        camera, projector = network.devices[self.camera], network.devices[self.projector]
        plane = network.planes[self.plane]
        pixels = np.ascontiguousarray(self.cells.camera_px if camera_px is None else camera_px, np.float64)
        return _reproject(camera.numbers, projector.numbers, plane.normal, plane.offset, pixels)


@compiled
def _reproject(
    camera: DeviceNumbers, projector: DeviceNumbers, normal: Floats, offset: float, camera_px: Floats
) -> tuple[Floats, Floats, Floats]:
    """`PlaneObservation.predict`."""
    count = len(camera_px)
    camera_lens, camera_warp, camera_sides, turn, centre = camera
    projector_lens, projector_warp, projector_sides, projector_turn, projector_centre = projector
    of_device, of_warp = len(camera_lens), len(camera_warp)
    pose, warp, second = of_device, of_device + 6, of_device + 6 + of_warp
    tilts = 2 * second

    rays, rays_by_lens, rays_by_warp = (
        np.empty((count, 3)),
        np.zeros((count, 3, of_device)),
        np.zeros((count, 3, of_warp)),
    )
    rays_into(camera_lens, camera_warp, camera_sides, camera_px, rays, rays_by_lens, rays_by_warp)
    along, off, before, deep = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 2))
    distance = offset - dot(normal, centre)
    for i in range(count):
        for k in range(3):
            along[i, k] = dot(turn[k], rays[i])
        facing = dot(along[i], normal)
        deep[i, 0] = distance / facing
        for k in range(3):
            along[i, k] /= facing
            off[i, k] = along[i, k] * distance
        for k in range(3):
            before[i, k] = 0.0
            for c in range(3):
                before[i, k] += projector_turn[c, k] * (off[i, c] + centre[c] - projector_centre[c])
        deep[i, 1] = before[i, 2]

    pixels, by_point = np.empty((count, 2)), np.empty((count, 2, 3))
    by_lens, by_warp = np.zeros((count, 2, of_device)), np.zeros((count, 2, of_warp))
    pixels_into(projector_lens, projector_warp, projector_sides, before, pixels, by_point, by_lens, by_warp)

    jacobian = np.empty((count, 2, tilts + 3))
    basis, by, onto, by_ray, point = tangent_basis(normal), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(count):
        for k in range(3):
            point[k] = off[i, k] + centre[k]
        for k in range(2):
            row = jacobian[i, k]
            for c in range(3):
                by[c] = dot(by_point[i, k], projector_turn[c])
            slid = dot(by, along[i])
            for c in range(3):
                onto[c] = by[c] - slid * normal[c]
            for c in range(3):
                by_ray[c] = deep[i, 0] * (onto[0] * turn[0, c] + onto[1] * turn[1, c] + onto[2] * turn[2, c])
            for c in range(of_device):
                row[c] = by_ray[0] * rays_by_lens[i, 0, c] + by_ray[1] * rays_by_lens[i, 1, c]
                row[second + c] = by_lens[i, k, c]
            for c in range(of_warp):
                row[warp + c] = by_ray[0] * rays_by_warp[i, 0, c] + by_ray[1] * rays_by_warp[i, 1, c]
                row[second + warp + c] = by_warp[i, k, c]
            for c in range(3):
                u, v = (c + 1) % 3, (c + 2) % 3
                row[pose + c] = off[i, u] * onto[v] - off[i, v] * onto[u]
                row[pose + 3 + c] = onto[c]
                from_projector_u, from_projector_v = point[u] - projector_centre[u], point[v] - projector_centre[v]
                row[second + pose + c] = by[u] * from_projector_v - by[v] * from_projector_u
                row[second + pose + 3 + c] = -by[c]
            for c in range(2):
                row[tilts + c] = -slid * (point[0] * basis[0, c] + point[1] * basis[1, c] + point[2] * basis[2, c])
            row[tilts + 2] = slid
    return pixels, jacobian, deep


NetworkProblem = Problem[Network, PlaneObservation]


def points_on(pixels: Floats, device: Device, plane: Plane) -> Floats:
    """Where the rays of a device's pixels (N, 2) meet a plane, (N, 3) in the room's frame."""
    rays, _, _ = device.rays(pixels)
    _, depth = _meet(rays, device.pose, plane)
    return device.pose @ (rays * depth[:, None])


def _meet(rays: Floats, pose: Pose, plane: Plane) -> tuple[Floats, Floats]:
    """Rays in the room's frame scaled to n · u = 1, (N, 3), and the depths at which they meet the plane, (N,)."""
    turned = pose.rotate(rays)
    facing = turned @ plane.normal
    return turned / facing[:, None], plane.offset_from(pose.translation) / facing


PairName = tuple[str, str]  # camera, projector


def pixels_of(matches: Matches, role: int) -> Floats:
    """Of a pair's camera, 0, or its projector, 1."""
    return matches.projector_px if role else matches.camera_px


@dataclass(frozen=True, eq=False)
class Overlaps:
    """`rasters` of devices that are part of several pairs; `sightings`: by such a device and another one that it shares
    matches with.
    """

    rasters: Mapping[str, ImageRaster]
    sightings: Mapping[tuple[str, str], SeenAt]

    @classmethod
    def of(cls, captures: Mapping[PairName, Matches], sizes: Mapping[str, Size]) -> "Overlaps":
        """From the matches of each pair."""
        pixels: dict[str, dict[str, tuple[Floats, Floats]]] = {}
        for (camera, projector), matches in captures.items():
            pixels.setdefault(camera, {})[projector] = matches.camera_px, matches.projector_px
            pixels.setdefault(projector, {})[camera] = matches.projector_px, matches.camera_px
        shared = {hub: partners for hub, partners in pixels.items() if len(partners) > 1}
        rasters = {
            hub: ImageRaster.fine(sizes[hub], [own for own, _ in by_partner.values()])
            for hub, by_partner in shared.items()
        }
        sightings = {
            (hub, partner): SeenAt.of(rasters[hub], *pixels_there)
            for hub, partners in shared.items()
            for partner, pixels_there in partners.items()
        }
        return cls(rasters, sightings)

    def match_px(self, pair: PairName) -> float:
        """Noise of a pair's matches in projector pixels, by how far they are off their neighbours; NaN if unknown."""
        camera, projector = pair
        if (camera, projector) in self.sightings:
            return self.sightings[camera, projector].noise_px
        if (projector, camera) not in self.sightings:
            return np.nan
        sighting = self.sightings[projector, camera]
        known = np.isfinite(sighting.by_own).all(axis=(-2, -1))
        return sighting.noise_px / float(np.sqrt(np.median(np.abs(np.linalg.det(sighting.by_own[known])))))

    def known_points(
        self, devices: Mapping[str, Device], hub: str, new: str, pairs: Collection[PairName]
    ) -> tuple[Floats, Floats]:
        """Points (N, 3) of the room that pairs with a placed `hub` tell, and the pixels (N, 2) of a `new` device."""
        raster, sighting = self.rasters[hub], self.sightings[hub, new]
        depth = np.full((raster.height, raster.width), np.nan)
        for partner in self._partners(hub, pairs):
            partner_depth, _ = depths(devices[hub], devices[partner], raster.centres, self.sightings[hub, partner])
            depth = np.where(np.isfinite(depth), depth, partner_depth)
        there = np.isfinite(depth) & np.isfinite(sighting.pixels).all(axis=-1)
        pose = devices[hub].pose
        rays, _ = unproject(devices[hub].lens, raster.centres[there])
        return pose @ (depth[there][:, None] * rays), sighting.pixels[there]

    def joints(
        self,
        network: Network,
        names: tuple[str, ...],
        labelled: Mapping[PairName, Matches],
        calibrated: Collection[PairName] = (),
    ) -> Iterator[SharedPoints]:
        """What ties devices where matches are on no plane; of pairs that are `calibrated` alone, what is new."""
        hubs = {hub: self._partners(hub, labelled) for hub in self.rasters if hub in names}
        hubs = {hub: partners for hub, partners in hubs.items() if len(partners) > 1}
        for hub, partners in hubs.items():
            joint = shared_points(
                names.index(hub),
                self.rasters[hub],
                {names.index(partner): self.sightings[hub, partner] for partner in partners},
                self._loose(hub, labelled),
                network,
                {names.index(partner): 1 + (partner in hubs) for partner in partners},
                [names.index(partner) for partner in partners if {(hub, partner), (partner, hub)} & set(calibrated)],
            )
            if joint is not None:
                yield joint

    def _partners(self, hub: str, pairs: Collection[PairName]) -> list[str]:
        return [pair[1 - pair.index(hub)] for pair in pairs if hub in pair]

    def _loose(self, hub: str, labelled: Mapping[PairName, Matches]) -> Bools:
        """Cells (h, w) of a device's raster without a match on a plane."""
        raster = self.rasters[hub]
        on_planes = np.zeros(raster.height * raster.width, np.bool_)
        for pair, matches in labelled.items():
            if hub in pair:
                pixels = pixels_of(matches, pair.index(hub))
                on_planes[raster.numbers(pixels[matches.labels >= 0])[0]] = True
        return ~on_planes.reshape(raster.height, raster.width)
