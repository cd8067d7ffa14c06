"""Points that one device shares with several others tie these, whatever surface they are on.

A pixel of the shared device, the hub, is a ray; each other device has a pixel where its own ray meets it. How far along
the hub's ray the point is, is estimated for each point, and eliminated from the normal equations (the Schur complement
of bundle adjustment; Triggs et al., "Bundle adjustment – a modern synthesis", 2000).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from calib.estimation import ROBUST_SIGMAS, Term, block_inflation
from calib.geometry import cross_matrix
from calib.networks.network import PER_NODE, PLACE, WARP, Device, Network
from calib.networks.raster import ImageRaster, SeenAt, depths
from calib.numerics import Bools, Floats, Ints, evenly
from calib.refinement import PER_DEVICE

_MOST, _FEWEST = 2000, 30
_STEPS = 4
_BEHIND = 100.0


@dataclass(frozen=True, eq=False)
class SharedPoints:
    """Points of one device, the hub, with their pixels in other devices that see them, too."""

    hub: int
    """Number of the device."""
    partners: tuple[int, ...]
    """Numbers of the other devices."""
    pixels: Floats
    """Of the hub, (M, 2)."""
    partner_pixels: Floats
    """Pixels of the others, (M, K, 2)."""
    variance: Floats
    """Of each coordinate there, infinite where one does not see the point, (M, K)."""
    depths: Floats
    """Along the hub's rays of z = 1, roughly, (M,)."""
    along: tuple[bool, ...] = ()
    """Which of the others tell only where along the hub's ray the point is, for their pixels' distances from its
    picture, an epipolar line, are counted elsewhere, (K,); () for none.
    """

    def columns(self, network: Network) -> Ints:
        """Those of the hub, then of all others, (18 (K + 1),)."""
        every = np.arange(network.size, dtype=np.int32)
        return np.concatenate([every[network.device_columns(device)] for device in (self.hub, *self.partners)])

    @cached_property
    def freedom(self) -> Ints:
        """Of each point (M,): two coordinates in each other's image, less the depth."""
        coordinates = np.where(self.along, 1, 2) if self.along else 2
        number = np.sum(coordinates * np.isfinite(self.variance), axis=1, dtype=np.int64) - 1
        return np.asarray(number, np.int64)

    def misfit(self, network: Network) -> Term:
        """The cost, under Huber's loss."""
        off, by_depth, jacobian, ahead = self._linearised(network)
        root = np.where(ahead[:, None], 1 / np.sqrt(self.variance), 0.0)[..., None]
        weighted = (
            jacobian + by_depth[..., None] * _slope_of_depth(root[..., 0] ** 2, by_depth, jacobian)[:, None, None]
        )
        residuals, by_columns = (root * off).reshape(len(off), -1), weighted * root[..., None]
        by_columns = by_columns.reshape(*residuals.shape, weighted.shape[-1])
        term = Term.robust(self.columns(network), residuals, by_columns, ROBUST_SIGMAS * np.sqrt(self.freedom / 2))
        return replace(term, cost=term.cost + _BEHIND * np.count_nonzero(~ahead))

    def depth_slopes(self, network: Network) -> Floats:
        """How the depths along the hub's rays follow `columns`, (M, Q)."""
        _, by_depth, jacobian, _ = self._linearised(network)
        return _slope_of_depth(1 / self.variance, by_depth, jacobian)

    def relative(self, network: Network) -> tuple[Floats, Floats]:
        """χ² of each point, over what half of all points would be below, (M,); and by how many sigmas the first device
        that sees it is off, across the line that the hub's ray is in its image, or along it if only that counts, (M,).
        """
        off, by_depth, _, ahead = self._linearised(network)
        square = np.sum(off**2 / self.variance[..., None], axis=(1, 2)) / scipy.special.chdtri(self.freedom, 0.5)
        first = np.arange(len(off)), np.argmax(np.isfinite(self.variance), axis=1)
        own, way = off[first], by_depth[first] / np.linalg.norm(by_depth[first], axis=1, keepdims=True)
        across = own[:, 0] * way[:, 1] - own[:, 1] * way[:, 0]
        if any(self.along):
            across = np.where(np.array(self.along)[first[1]], np.sum(own * way, axis=1), across)
        return np.where(ahead, square, np.inf), np.where(ahead, across / np.sqrt(self.variance[first]), 0.0)

    def _linearised(self, network: Network) -> tuple[Floats, Floats, Floats, Bools]:
        """At the best depths: how far predictions are off (M, K, 2), how these follow the depth, and the columns
        (M, K, 2, Q), and which points (M,) are ahead of all devices.
        """
        hub = network.devices[self.hub]
        partners = [network.devices[number] for number in self.partners]
        rays, by_lens, by_warp = hub.rays(self.pixels)
        turned, depth = hub.pose.rotate(rays), self.depths
        known = np.isfinite(self.variance)
        for _ in range(_STEPS):
            off, by_depth, _ = self._predicted(partners, hub, turned, depth)
            weighted = by_depth / self.variance[..., None]
            square = np.sum(weighted * by_depth, axis=(1, 2))
            step = np.sum(weighted * off, axis=(1, 2)) / np.maximum(square, 1e-300)
            depth = np.where(depth - step > 0.2 * depth, depth - step, 0.2 * depth)
        off, by_depth, before = self._predicted(partners, hub, turned, depth)
        ahead = (depth > 0) & ((before[..., 2] > 0) | ~known).all(axis=1)
        by_hub = np.concatenate(
            [
                depth[:, None, None] * (hub.pose.rotation @ by_lens),
                -cross_matrix(depth[:, None] * turned),
                np.broadcast_to(np.eye(3), (len(depth), 3, 3)),
                depth[:, None, None] * (hub.pose.rotation @ by_warp),
            ],
            axis=2,
        )
        jacobian = np.zeros((*off.shape, PER_NODE * (1 + len(partners))))
        for k, partner in enumerate(partners):
            _, by_point, by_lens, by_warp = partner.pixels(before[:, k])
            to_pixels = by_point @ partner.pose.rotation.T
            points = partner.pose.rotate(before[:, k])
            jacobian[:, k, :, :PER_NODE] = to_pixels @ by_hub
            own = jacobian[:, k, :, PER_NODE * (k + 1) : PER_NODE * (k + 2)]
            own[..., :PER_DEVICE], own[..., WARP] = by_lens, by_warp
            own[..., PER_DEVICE : PLACE.start], own[..., PLACE] = to_pixels @ cross_matrix(points), -to_pixels
        jacobian[~known | ~ahead[:, None]] = 0.0
        for k, is_along in enumerate(self.along):
            if not is_along:
                continue
            way = by_depth[:, k] / np.maximum(np.linalg.norm(by_depth[:, k], axis=1, keepdims=True), 1e-300)
            off[:, k] = np.sum(off[:, k] * way, axis=1)[:, None] * way
            jacobian[:, k] = way[:, :, None] * (way[:, None] @ jacobian[:, k])
        return off, by_depth, jacobian, ahead

    def _predicted(
        self, partners: list[Device], hub: Device, turned: Floats, depth: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Off (M, K, 2) at some depths, the derivatives by these, and the points (M, K, 3) in the others' frames."""
        points = hub.pose.translation + depth[:, None] * turned
        before = np.stack([device.pose.undo(points) for device in partners], axis=1)
        off, by_depth = np.zeros_like(self.partner_pixels), np.zeros_like(self.partner_pixels)
        known = np.isfinite(self.variance)
        for k, device in enumerate(partners):
            predicted, by_point, _, _ = device.pixels(before[:, k])
            off[:, k] = np.where(known[:, k, None], predicted - self.partner_pixels[:, k], 0.0)
            by_depth[:, k] = np.einsum("mij,mj->mi", by_point, device.pose.inverse().rotate(turned))
        by_depth[~known] = 0.0
        return np.nan_to_num(off), np.nan_to_num(by_depth), before


def _slope_of_depth(weight: Floats, by_depth: Floats, jacobian: Floats) -> Floats:
    """Of the best depth under weights (M, K), (M, Q)."""
    count, weighted = len(weight), weight[..., None] * by_depth
    along = np.sum(weighted * by_depth, axis=(1, 2))
    pull = (weighted.reshape(count, 1, -1) @ jacobian.reshape(count, by_depth[0].size, -1))[:, 0]
    slope: Floats = -pull / np.maximum(along, 1e-300)[:, None]
    return slope


def shared_points(
    hub: int,
    raster: ImageRaster,
    sightings: Mapping[int, SeenAt],
    loose: Bools,
    network: Network,
    repeats: Mapping[int, int],
    along: Collection[int] = (),
) -> SharedPoints | None:
    """Of the cells `loose` (h, w) that two devices or more see; None of too few.

    `sightings`: by number of the other device. `repeats`: how many hubs each one's matches are counted in. `along`: the
    others as of `SharedPoints`. Variances are as much larger than noise as the residuals show, and as errors that are
    alike over blocks show.
    """
    partners = tuple(sightings)
    there = np.stack([np.isfinite(sightings[k].pixels).all(axis=-1) for k in partners], axis=-1) & loose[..., None]
    several = there.sum(axis=-1) > 1
    row, column = np.unravel_index(evenly(several.ravel(), _MOST), several.shape)
    if len(row) < _FEWEST:
        return None
    every = [depths(network.devices[hub], network.devices[k], raster.centres, sightings[k]) for k in partners]
    depth = np.stack([partner_depths[0][row, column] for partner_depths in every], axis=1)
    sensitive = np.stack([np.linalg.norm(partner_depths[1][row, column], axis=1) for partner_depths in every], axis=1)
    depth[~there[row, column]] = np.nan
    first = np.take_along_axis(depth, np.argmin(np.where(np.isfinite(depth), sensitive, np.inf), axis=1)[:, None], 1)
    good = np.isfinite(first[:, 0])
    if np.count_nonzero(good) < _FEWEST:
        return None
    row, column = row[good], column[good]
    pixels = np.stack([sightings[k].pixels[row, column] for k in partners], axis=1)
    variance = np.stack(
        [repeats[k] * sightings[k].noise_px ** 2 / np.maximum(sightings[k].count[row, column], 1) for k in partners],
        axis=1,
    )
    known = there[row, column]
    shared = SharedPoints(
        hub,
        partners,
        raster.centres[row, column],
        np.where(known[..., None], pixels, 0.0),
        np.where(known, variance, np.inf),
        first[good, 0],
        tuple(k in along for k in partners) if along else (),
    )
    relative, across = shared.relative(network)
    larger = max(1.0, float(np.median(relative)))
    across = np.clip(across / np.sqrt(larger), -ROBUST_SIGMAS, ROBUST_SIGMAS)
    return replace(shared, variance=shared.variance * larger * block_inflation(shared.pixels, across))
