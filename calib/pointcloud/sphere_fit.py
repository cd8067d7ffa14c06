"""Spheres: a robust geometric least-squares fit with its covariance, and the search for one of known radius.

The search is random sample consensus (Fischler and Bolles 1981) in an organised cloud. Seeds are spread over the image,
less than half the sphere's image apart. Three points of a ring around a seed define one sphere of that radius that
bulges towards the camera. Its score is the share of evenly spaced samples of the sphere's image whose points lie on the
sphere. A plane scores a quarter.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Intrinsics
from calib.numerics import Bools, Floats, Ints, biweight, influence_on, robust_covariance, robust_sigma
from calib.pointcloud.pixel_grid import NONE, without_gaps

_STEPS = 50
_CONVERGED = 1e-10
_STEEPEST = 0.17  # cosine of 80°; at steeper angles, noise decides whether a ray meets the sphere


@dataclass(frozen=True)
class Sphere:
    """A sphere fitted to points, in their unit."""

    centre: Floats
    """(3,)."""
    radius: float
    covariance: Floats
    """Of centre and radius, (4, 4); the radius's row and column are 0 if it was held fixed."""
    residual: Floats
    """Signed distance of each point from the surface, positive outside, (N,)."""
    jacobian: Floats
    """Derivatives of the surface's outward displacement at each point, by centre and radius, (N, 4)."""

    @property
    def influence(self) -> Floats:
        """Derivatives (4, N) of centre and radius, both free, by the points' distances."""
        return influence_on(self.jacobian, self.residual)

    @property
    def centre_sigma(self) -> Floats:
        """Standard deviation of each coordinate of the centre, (3,)."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def radius_sigma(self) -> float:
        """Standard deviation of the radius, 0 if it was held fixed."""
        return float(np.sqrt(self.covariance[3, 3]))


def fit_sphere(
    points: Floats,
    cluster: Ints,
    centre: Floats,
    radius: float,
    *,
    fixed_radius: bool = False,
    rays: Floats | None = None,
) -> Sphere:
    """Minimise the points' (N, 3) distances from the surface by Gauss and Newton's method with Tukey's weights.

    Starts at `centre` (3,) and `radius`. `cluster` (N,): labels from 0 of points whose errors may correlate. `rays`
    (N, 3): unit vectors from the cameras, along which the points err. Distances are then measured to the tangent planes
    where the rays meet the sphere; nearest points would bias the radius by the noise variance over the radius. Raises
    ValueError for fewer than four points.
    """
    if len(points) < 4:
        raise ValueError(f"a sphere needs four points, found {len(points)}")
    state = np.array([*centre, radius])
    free = 3 if fixed_radius else 4
    residual, jacobian = _distances(points, state, rays)
    weight = biweight(residual)
    for _ in range(_STEPS):
        root = np.sqrt(weight)[:, None]
        step = np.linalg.lstsq(root * jacobian[:, :free], -root[:, 0] * residual, rcond=None)[0]
        state[:free] += step
        residual, jacobian = _distances(points, state, rays)
        weight = biweight(residual)
        if np.linalg.norm(step) < _CONVERGED * radius:
            break
    covariance = np.zeros((4, 4))
    covariance[:free, :free] = robust_covariance(jacobian[:, :free], residual, cluster)
    return Sphere(state[:3].copy(), float(state[3]), covariance, residual, -jacobian)


def _distances(points: Floats, state: Floats, rays: Floats | None) -> tuple[Floats, Floats]:
    """Signed distances (N,) of points from a sphere (centre, radius), and their derivatives (N, 4) by these."""
    from_centre = points - state[:3]
    length = np.linalg.norm(from_centre, axis=1)
    outwards, distance = from_centre / length[:, None], length - state[3]
    if rays is not None:
        along = np.sum(from_centre * rays, axis=1)
        inside2 = along**2 - length**2 + state[3] ** 2  # half a ray's way through the sphere, squared
        meets = inside2 > (_STEEPEST * state[3]) ** 2
        before = -along[meets] - np.sqrt(inside2[meets])
        outwards[meets] = (from_centre[meets] + before[:, None] * rays[meets]) / state[3]
        distance[meets] = -before * np.sum(outwards[meets] * rays[meets], axis=1)
    return distance, np.hstack([-outwards, -np.ones((len(points), 1))])


# A smaller image has too few points.
_SMALLEST_IMAGE_PX = 4.0
_RING, _SAMPLES_PER_SEED = 0.6, 8
# The rim of the image is left out, where points are missing or least accurate.
_SCORED, _SCORED_POINTS = 0.85, 80
_LEAST_SHARE = 0.6
# Tolerance as a share of the radius, so that a scale error of some per cent does not hide the sphere.
_TOLERANCE, _TOLERANCE_SIGMAS, _LARGEST_TOLERANCE = 0.05, 3.0, 0.2
_BATCH = 8192


@dataclass(frozen=True)
class OrganisedPoints:
    """`points` (N, 3) in the camera's frame; `index` (H, W): the point of each pixel, `NONE` for none."""

    points: Floats
    index: Ints
    camera: Intrinsics

    def at(self, pixels: Floats) -> Ints:
        """Indices of the points at pixels (..., 2), rounded; `NONE` where there is none or outside of the image."""
        with np.errstate(invalid="ignore"):
            inside = np.all((pixels > -0.5) & (pixels < (self.camera.width - 0.5, self.camera.height - 0.5)), axis=-1)
        column, row = np.moveaxis(np.rint(np.where(inside[..., None], pixels, 0)).astype(np.int64), -1, 0)
        return np.where(inside, self.index[row, column], NONE)


def find_sphere(cloud: OrganisedPoints, radius: float, free: Bools, rng: np.random.Generator) -> Floats | None:
    """The centre (3,) of the sphere of this radius with the best score, or None if there is none.

    Only the points marked in `free` (N,) are used.
    """
    index = np.where((cloud.index != NONE) & free[cloud.index], cloud.index, NONE)
    noise = _depth_noise(OrganisedPoints(cloud.points, index, cloud.camera))
    cloud = OrganisedPoints(cloud.points, without_gaps(index), cloud.camera)
    best, best_share = None, _LEAST_SHARE
    for centres in _candidates(cloud, radius, rng):
        shares = _shares(cloud, centres, radius, noise)
        if len(shares) and shares.max() > best_share:
            best, best_share = centres[int(np.argmax(shares))], float(shares.max())
    return best


def image_radius_px(camera: Intrinsics, depth: Floats, radius: float) -> Floats:
    """Radius in pixels of a sphere's image at depths (N,)."""
    return np.mean(camera.focal_px) * radius / depth


def _depth_noise(cloud: OrganisedPoints) -> float:
    """Standard deviation of depth at depth 1, from second differences along rows; it grows with the depth squared."""
    before, middle, right = cloud.index[:, :-2], cloud.index[:, 1:-1], cloud.index[:, 2:]
    there = (before != NONE) & (middle != NONE) & (right != NONE)
    z = cloud.points[:, 2]
    bend = (z[before[there]] - 2 * z[middle[there]] + z[right[there]]) / z[middle[there]] ** 2
    return robust_sigma(bend) / float(np.sqrt(6))


def _seeds(cloud: OrganisedPoints, radius: float) -> Ints:
    """Points (S,) on lattices whose step is a quarter to half of the radius of the sphere's image there."""
    row, column = np.nonzero(cloud.index != NONE)
    seed = cloud.index[row, column]
    image = image_radius_px(cloud.camera, cloud.points[seed, 2], radius)
    step = 2 ** np.floor(np.log2(np.maximum(image, 2) / 2)).astype(np.int64)
    chosen = (image >= _SMALLEST_IMAGE_PX) & (row % step == step // 2) & (column % step == step // 2)
    seeds: Ints = seed[chosen]
    return seeds


def _candidates(cloud: OrganisedPoints, radius: float, rng: np.random.Generator) -> list[Floats]:
    """Centres in batches (M, 3) of the spheres through three points of a ring around each seed."""
    seeds = np.repeat(_seeds(cloud, radius), _SAMPLES_PER_SEED)
    batches = []
    for start in range(0, len(seeds), _BATCH):
        seed = seeds[start : start + _BATCH]
        ring = _RING * image_radius_px(cloud.camera, cloud.points[seed, 2], radius)
        angle = rng.uniform(0, 2 * np.pi, len(seed))[:, None] + 2 * np.pi / 3 * np.arange(3)
        offset = ring[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        corner = cloud.at(cloud.camera.project(cloud.points[seed])[:, None] + offset)
        corner = corner[np.all(corner != NONE, axis=1)]
        batches.append(_centres(cloud.points[corner], radius))
    return batches


def _centres(triples: Floats, radius: float) -> Floats:
    """Centres of spheres through triples (M, 3, 3) of points, behind them as seen from the origin. Triples that are too
    far apart are left out."""
    a, b, c = np.moveaxis(triples, 1, 0)
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    size2 = np.sum(normal**2, axis=1)
    ab2, ac2 = np.sum(ab**2, axis=1)[:, None], np.sum(ac**2, axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_centre = (np.cross(normal, ab) * ac2 + np.cross(ac, normal) * ab2) / (2 * size2)[:, None]
        height2 = radius**2 - np.sum(to_centre**2, axis=1)
        away = normal * (np.sign(np.sum(normal * a, axis=1)) / np.sqrt(size2))[:, None]
    good = height2 > 0
    centres: Floats = (a + to_centre)[good] + np.sqrt(height2[good])[:, None] * away[good]
    return centres


def _shares(cloud: OrganisedPoints, centres: Floats, radius: float, noise: float) -> Floats:
    """The scores (M,): share of the samples of each sphere's image whose points lie on the sphere."""
    count = np.arange(_SCORED_POINTS) + 0.5
    spiral = np.sqrt(count / _SCORED_POINTS), np.pi * (1 + np.sqrt(5)) * count  # evenly over a disc (Vogel 1979)
    disc = _SCORED * spiral[0][:, None] * np.stack([np.cos(spiral[1]), np.sin(spiral[1])], axis=-1)
    image = image_radius_px(cloud.camera, centres[:, 2], radius)
    point = cloud.at(cloud.camera.project(centres)[:, None] + image[:, None, None] * disc)
    off = np.abs(np.linalg.norm(cloud.points[point] - centres[:, None], axis=2) - radius)
    tolerance = np.maximum(_TOLERANCE * radius, _TOLERANCE_SIGMAS * noise * centres[:, 2] ** 2)
    tolerance = np.minimum(tolerance, _LARGEST_TOLERANCE * radius)
    shares: Floats = np.mean((point != NONE) & (off < tolerance[:, None]), axis=1)
    return shares
