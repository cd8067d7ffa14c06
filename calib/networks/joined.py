"""Surfaces from all rays: where each projector's pixels fell, by all cameras that saw them.

A projector's ray is one line in the room, whichever camera sees its light. Each camera tells how far along it the
surface is, with a variance; the weighted mean of these is what all of them say, and their differences are the honest
test of a network, for nothing else ties cameras so directly.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.geometry import Matches, unproject
from calib.networks.estimate import NetworkEstimate
from calib.networks.raster import ImageRaster, SeenAt, depths
from calib.networks.shared_points import SharedPoints
from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints, evenly

_LEAST_SHARED, _SAMPLE = 50, 300
_ELSEWHERE, _OF_MEDIAN = 0.005, 10.0  # of the depth, and of the median difference: the surface is another one


@dataclass(frozen=True, eq=False)
class Joined:
    """The points of one projector's light, on a grid (h, w) of cells of its image; NaN for none."""

    points: Floats
    """In the room's frame, (h, w, 3)."""
    sigma: Floats
    """Along the projector's ray, by the matches' noise, (h, w)."""
    best_sigma: Floats
    """The same of the best camera alone."""
    cameras: Ints
    """How many saw it, (h, w)."""
    seen_px: Mapping[str, Floats]
    """By camera, where in its image, (h, w, 2)."""
    disagreements: tuple["DepthDisagreement", ...]
    """Of each two cameras."""

    @property
    def gain(self) -> float:
        """By what factor sigma is smaller than the best camera's, median where several saw a point; NaN of none."""
        several = self.cameras > 1
        return float(np.median((self.best_sigma / self.sigma)[several])) if several.any() else float("nan")


@dataclass(frozen=True)
class DepthDisagreement:
    """Two cameras' depths in one projector's light: median difference, relative to the depth, what the sigmas of
    matches and devices would make of it, and the number of cells that both saw. `elsewhere`: the share of these at
    which they differ by far more than at most.
    """

    first: str
    second: str
    relative: float
    expected: float
    count: int
    elsewhere: float = 0.0


def joined(estimate: NetworkEstimate, projector: str, by_camera: Mapping[str, Matches]) -> Joined:
    """All cameras' matches with one projector, (N,) each."""
    device = estimate.device(projector)
    raster = ImageRaster.fine(estimate.sizes[projector], [matches.projector_px for matches in by_camera.values()])
    height, width = raster.height, raster.width
    rays, _ = unproject(device.lens, raster.centres.reshape(-1, 2))
    rays = device.pose.rotate(rays)
    pixels_of: dict[str, Floats] = {}
    camera_depths: list[Floats] = []
    variances: list[Floats] = []
    chances: list[Floats] = []
    for camera, matches in by_camera.items():
        at = SeenAt.of(raster, matches.projector_px, matches.camera_px)
        noise = estimate.noise[camera, projector]
        depth, by_camera_px = depths(device, estimate.device(camera), raster.centres, at)
        # Matches err in the projector's pixels.
        by_px = np.linalg.norm(np.einsum("hwij,hwi->hwj", at.by_own, by_camera_px), axis=-1).ravel()
        by_chance = by_px**2 * noise.match_px**2 / np.maximum(at.count.ravel(), 1)
        pixels_of[camera] = at.pixels
        camera_depths.append(depth.ravel())
        chances.append(by_chance)
        variances.append(by_chance + by_px**2 * noise.systematic_px**2)
    depth, variance = np.stack(camera_depths), np.stack(variances)
    weight = np.where(np.isfinite(depth), 1 / variance, 0.0)
    total = weight.sum(axis=0)
    there = total > 0
    safe = np.where(there, total, 1.0)
    mean = np.where(there, np.nansum(weight * np.nan_to_num(depth), axis=0) / safe, np.nan)
    points = (device.pose.translation + mean[:, None] * rays).reshape(height, width, 3)
    sigma = np.where(there, safe**-0.5, np.nan).reshape(height, width)
    best = np.where(there, np.where(weight > 0, weight, 0).max(axis=0, initial=1e-300) ** -0.5, np.nan)
    return Joined(
        points,
        sigma,
        best.reshape(height, width),
        np.count_nonzero(weight, axis=0).reshape(height, width),
        pixels_of,
        tuple(_disagreements(estimate, projector, raster, pixels_of, depth, np.stack(chances))),
    )


def _disagreements(
    estimate: NetworkEstimate,
    projector: str,
    raster: ImageRaster,
    pixels_of: Mapping[str, Floats],
    depth: Floats,
    variance: Floats,
) -> list[DepthDisagreement]:
    """Of each two cameras, in the order of `pixels_of`; depths and their variances by noise, (cameras, cells)."""
    disagreements, hub, network = [], estimate.names.index(projector), estimate.network
    for (i, first), (j, second) in combinations(enumerate(pixels_of), 2):
        both = np.isfinite(depth[i]) & np.isfinite(depth[j])
        if np.count_nonzero(both) < _LEAST_SHARED:
            continue
        differences = 2 * np.abs(depth[i, both] - depth[j, both]) / (depth[i, both] + depth[j, both])
        off = float(np.median(differences))
        elsewhere = float(np.mean(differences > max(_ELSEWHERE, _OF_MEDIAN * off)))
        some = evenly(both, _SAMPLE)
        slopes = np.zeros((len(some), network.size))
        for number, name, sign in ((i, first, 1), (j, second, -1)):
            alone = (estimate.names.index(name),)
            pixels = raster.centres.reshape(-1, 2)[some], pixels_of[name].reshape(-1, 1, 2)[some]
            points = SharedPoints(hub, alone, *pixels, np.ones((len(some), 1)), depth[number, some])
            slopes[:, points.columns(network)] += sign * points.depth_slopes(network)
        by_devices = np.einsum("nc,cd,nd->n", slopes, estimate.covariance, slopes, optimize=True)
        sigma = np.sqrt(variance[i, some] + variance[j, some] + by_devices)
        expected = float(np.median(2 * sigma / (depth[i, some] + depth[j, some]))) / SIGMA_PER_MEDIAN
        disagreements.append(DepthDisagreement(first, second, off, expected, int(both.sum()), elsewhere))
    return disagreements
