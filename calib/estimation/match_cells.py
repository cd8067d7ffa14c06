"""Average matches on a plane over cells, so that the refinement costs the same for 10⁴ and 10⁷ matches.

In a cell of some tens of camera pixels, the mean deviation from the plane's homography carries all the information of
the cell's matches. Lens distortion is curved within a cell and would bias the mean: a fitted polynomial is part of what
they deviate from.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import cv2
import numpy as np

from calib.estimation.cell_sums import Raster, Reference, slots, sums_over_cells
from calib.geometry import FACES, Matches, TooFewMatchesError, homography_between, mapped
from calib.numerics import (
    CONIC,
    MEDIAN_LENGTH,
    TERMS,
    Bools,
    Floats,
    Ints,
    coefficients_of,
    evenly,
    in_parallel,
    monomials,
    normalisation,
)

_CELLS_PER_PLANE = 200
_SAMPLE = 5_000  # the median of so many deviations is known to 1 %
_SMALL_SAMPLE = 1_000
_SPARSE = 0.2
_OUTLIER_SIGMAS = 4.0
_CUTS = 4


@dataclass(frozen=True)
class Cells:
    """Means of matches over cells of the camera image.

    `camera_px`, `projector_px`: (M, 2). `plane`: (M,) the label of the matches. `sigma_px`: (M,) standard error of each
    coordinate of `projector_px` if matches err independently; `coarseness`: (M,) the stated sigma of the cell's matches
    over that of a typical match, 1 if none is stated. `noise_px`: scatter of a typical match. `rejected`: share of
    outliers, which were left out.
    """

    camera_px: Floats
    projector_px: Floats
    plane: Ints
    sigma_px: Floats
    coarseness: Floats
    noise_px: float
    rejected: float

    def __len__(self) -> int:
        return len(self.plane)

    def __getitem__(self, chosen: Bools | slice) -> "Cells":
        """The cells at a mask or slice."""
        return Cells(
            self.camera_px[chosen],
            self.projector_px[chosen],
            self.plane[chosen],
            self.sigma_px[chosen],
            self.coarseness[chosen],
            self.noise_px,
            self.rejected,
        )


def joined(a: Cells, b: Cells) -> Cells:
    """Concatenate cells; noise and rejected share are taken from `a`."""
    return replace(
        a,
        camera_px=np.concatenate([a.camera_px, b.camera_px]),
        projector_px=np.concatenate([a.projector_px, b.projector_px]),
        plane=np.concatenate([a.plane, b.plane]),
        sigma_px=np.concatenate([a.sigma_px, b.sigma_px]),
        coarseness=np.concatenate([a.coarseness, b.coarseness]),
    )


def into_cells(matches: Matches, labels: Sequence[int] = FACES, plane: Ints | None = None) -> Cells:
    """Average the matches with each label over cells, leaving out those that deviate from their neighbours.

    `plane` (N,): labels to use instead of the faces. Raises TooFewMatchesError if a label has fewer than four matches.
    """
    label = matches.labels if plane is None else plane
    chosen = in_parallel(lambda name: label == name, labels)
    counts = [np.count_nonzero(own) for own in chosen]
    for name, count in zip(labels, counts, strict=True):
        if count < 4:
            raise TooFewMatchesError(f"face {name} has {count} matches; a homography needs at least four")
    typical = _typical_sigma(matches, reduce(np.logical_or, chosen))

    def sampled(own: Bools) -> tuple[Matches, Reference]:
        sample = matches[evenly(own, _SAMPLE)]
        return sample, _reference(sample, typical)

    samples, references = zip(*in_parallel(sampled, chosen), strict=True)
    rasters = [_raster(sample.camera_px) for sample in samples]
    limits = [(_OUTLIER_SIGMAS * reference.sigma) ** 2 for reference in references]
    sums = sums_over_cells(matches, label, slots(labels), references, rasters, limits, typical)
    means = [_means(*of_plane) for of_plane in zip(labels, sums, references, strict=True)]

    squares, freedom = (sum(mean.scatter[i] for mean in means) for i in (0, 1))
    noise = max(float(np.sqrt(squares / max(freedom, 1.0))), 1e-6)
    return Cells(
        np.concatenate([mean.camera_px for mean in means]),
        np.concatenate([mean.projector_px for mean in means]),
        np.concatenate([mean.plane for mean in means]),
        noise / np.sqrt(np.concatenate([mean.weight for mean in means])),
        np.concatenate([mean.coarseness for mean in means]),
        noise,
        1.0 - sum(mean.kept for mean in means) / sum(counts),
    )


def follow_one_plane(matches: Matches, least_px: float) -> Bools:
    """Return the inliers (N,) of the dominant homography plus lens polynomial; deviations up to `least_px` are inliers
    in any case.

    Raises TooFewMatchesError if there are fewer than four matches.
    """
    if len(matches) < 4:
        raise TooFewMatchesError(f"a plane has {len(matches)} matches; a homography needs at least four")
    every = np.ones(len(matches), np.bool_)
    typical = _typical_sigma(matches, every)
    reference = _reference(matches[evenly(every, _SAMPLE)], typical)
    predicted = reference.straight(matches.camera_px) + reference.curved(matches.camera_px)
    off = np.linalg.norm(matches.projector_px - predicted, axis=1)
    coarse = 1.0 if matches.sigma_px is None else matches.sigma_px / typical
    near: Bools = off <= np.maximum(_OUTLIER_SIGMAS * reference.sigma * coarse, least_px)
    return near


def _typical_sigma(matches: Matches, chosen: Bools) -> float:
    """Return the sigma of a match of weight 1: the median of (a sample of) the stated sigmas, 1 if none is stated."""
    if matches.sigma_px is None:
        return 1.0
    return float(np.median(matches.sigma_px[evenly(chosen, _SAMPLE)]))


@dataclass(frozen=True)
class _Means:
    """Cell means (M,) of one plane; `scatter`: sum of squared deviations of both coordinates, degrees of freedom."""

    camera_px: Floats
    projector_px: Floats
    plane: Ints
    weight: Floats
    coarseness: Floats
    scatter: tuple[float, float]
    kept: int


def _means(label: int, sums: Floats, reference: Reference) -> _Means:
    """Compute the means over the cells of one plane from their sums."""
    count = sums[:, 0]
    # A cell with far fewer matches than a typical match's cell holds stray labels, not a piece of the plane.
    full = np.sort(count[count > 0])
    if not len(full):
        raise TooFewMatchesError(f"the matches of face {label} follow no homography")
    typical = full[np.searchsorted(np.cumsum(full), full.sum() / 2)]
    sums = sums[count >= max(1.0, _SPARSE * typical)]
    count, weight = sums[:, 0], sums[:, 1]
    camera_px, deviation = sums[:, 2:4] / weight[:, None], sums[:, 4:6] / weight[:, None]
    return _Means(
        camera_px,
        reference.straight(camera_px) + reference.curved(camera_px) + deviation,
        np.full(len(sums), label, np.int32),
        weight,
        np.sqrt(count / weight),
        (float(sums[:, 6].sum()), max(2.0 * count.sum() - 2 * TERMS, 1.0)),
        int(count.sum()),
    )


def _reference(sample: Matches, typical_sigma_px: float) -> Reference:
    """Fit homography and polynomial to the inliers of a plane."""
    weight = np.ones(len(sample)) if sample.sigma_px is None else (typical_sigma_px / sample.sigma_px) ** 2
    inside = _near_a_homography(sample)
    homography = homography_between(sample.camera_px[inside], sample.projector_px[inside])
    offset = sample.projector_px - mapped(homography, sample.camera_px)
    scale = normalisation(sample.camera_px)
    terms = monomials(sample.camera_px, scale).T
    if inside.sum() < 3 * TERMS:
        terms[CONIC:] = 0.0  # too few matches for more
    for _ in range(_CUTS):
        coefficients = coefficients_of(terms, offset, weight * inside)
        deviation = offset - terms.T @ coefficients
        size = np.sqrt(weight * (deviation[:, 0] ** 2 + deviation[:, 1] ** 2))
        # A polynomial through few matches reduces their scatter; correct for its degrees of freedom.
        freedom = max(1.0 - np.count_nonzero(terms.any(axis=1)) / max(inside.sum(), 1), 0.1)
        sigma = max(float(np.median(size[inside])) / MEDIAN_LENGTH / np.sqrt(freedom), 1e-9)
        inside = size <= _OUTLIER_SIGMAS * sigma
    return Reference(homography, scale, coefficients, sigma)


def _near_a_homography(sample: Matches) -> Bools:
    """Return the inliers (N,) of one homography, by the least median of squares."""
    every = np.ones(len(sample), bool)
    few = sample[:: max(1, len(sample) // _SMALL_SAMPLE)]
    homography, _ = cv2.findHomography(few.camera_px, few.projector_px, cv2.LMEDS) if len(few) > 4 else (None, None)
    if homography is None:
        return every
    size = np.linalg.norm(sample.projector_px - mapped(np.asarray(homography, np.float64), sample.camera_px), axis=1)
    near: Bools = size <= 2 * _OUTLIER_SIGMAS * np.median(size) / MEDIAN_LENGTH
    return near


def _raster(camera_px: Floats) -> Raster:
    low, high = camera_px.min(axis=0), camera_px.max(axis=0)
    # The share of the bounding box that a face fills is unknown; half is typical for a corner's faces.
    side = max(1.0, float(np.sqrt(np.prod(np.maximum(high - low, 1.0)) / (2 * _CELLS_PER_PLANE))))
    columns, rows = (int(reach / side) + 1 for reach in high - low)
    return Raster(low, side, columns, rows)
