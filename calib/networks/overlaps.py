"""What pairs of a network have in common, in the image of each device that is part of several pairs."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from calib.geometry import Matches, Size, unproject
from calib.networks.network import Device, Network
from calib.networks.raster import ImageRaster, SeenAt, depths
from calib.networks.shared_points import SharedPoints, shared_points
from calib.numerics import Bools, Floats

PairName = tuple[str, str]  # camera, projector


def pixels_of(matches: Matches, role: int) -> Floats:
    """Of a pair's camera, 0, or its projector, 1."""
    return matches.projector_px if role else matches.camera_px


@dataclass(frozen=True, eq=False)
class Overlaps:
    """`rasters` of devices that are part of several pairs; `seen`: by such a device and another one that it shares
    matches with.
    """

    rasters: Mapping[str, ImageRaster]
    seen: Mapping[tuple[str, str], SeenAt]

    @classmethod
    def of(cls, captures: Mapping[PairName, Matches], sizes: Mapping[str, Size]) -> "Overlaps":
        """From the matches of each pair."""
        pixels: dict[str, dict[str, tuple[Floats, Floats]]] = {}
        for (camera, projector), matches in captures.items():
            pixels.setdefault(camera, {})[projector] = matches.camera_px, matches.projector_px
            pixels.setdefault(projector, {})[camera] = matches.projector_px, matches.camera_px
        shared = {hub: others for hub, others in pixels.items() if len(others) > 1}
        rasters = {hub: ImageRaster.fine(sizes[hub], [own for own, _ in each.values()]) for hub, each in shared.items()}
        seen = {
            (hub, other): SeenAt.of(rasters[hub], *each)
            for hub, others in shared.items()
            for other, each in others.items()
        }
        return cls(rasters, seen)

    def match_px(self, pair: PairName) -> float:
        """Noise of a pair's matches in projector pixels, by how far they are off their neighbours; NaN if unknown."""
        camera, projector = pair
        if (camera, projector) in self.seen:
            return self.seen[camera, projector].noise_px
        if (projector, camera) not in self.seen:
            return np.nan
        seen = self.seen[projector, camera]
        known = np.isfinite(seen.by_own).all(axis=(-2, -1))
        return seen.noise_px / float(np.sqrt(np.median(np.abs(np.linalg.det(seen.by_own[known])))))

    def known_points(
        self, devices: Mapping[str, Device], hub: str, new: str, pairs: Collection[PairName]
    ) -> tuple[Floats, Floats]:
        """Points (N, 3) of the room that pairs with a placed `hub` tell, and the pixels (N, 2) of a `new` device."""
        raster, seen = self.rasters[hub], self.seen[hub, new]
        depth = np.full((raster.height, raster.width), np.nan)
        for other in self._partners(hub, pairs):
            told, _ = depths(devices[hub], devices[other], raster.centres, self.seen[hub, other])
            depth = np.where(np.isfinite(depth), depth, told)
        there = np.isfinite(depth) & np.isfinite(seen.pixels).all(axis=-1)
        pose = devices[hub].pose
        rays, _ = unproject(devices[hub].lens, raster.centres[there])
        return pose @ (depth[there][:, None] * rays), seen.pixels[there]

    def joints(
        self, network: Network, names: tuple[str, ...], labelled: Mapping[PairName, Matches]
    ) -> Iterator[SharedPoints]:
        """What ties devices where matches are on no plane."""
        hubs = {hub: self._partners(hub, labelled) for hub in self.rasters if hub in names}
        hubs = {hub: others for hub, others in hubs.items() if len(others) > 1}
        for hub, others in hubs.items():
            found = shared_points(
                names.index(hub),
                self.rasters[hub],
                {names.index(other): self.seen[hub, other] for other in others},
                self._loose(hub, labelled),
                network,
                {names.index(other): 1 + (other in hubs) for other in others},
            )
            if found is not None:
                yield found

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
