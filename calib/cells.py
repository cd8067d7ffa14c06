"""Many matches on a plane → few equivalent ones, so that the refinement costs the same for 10⁴ and 10⁷ matches.

Over a cell of some tens of camera pixels the mean deviation from the plane's homography carries everything that the
cell's matches say. What a lens does beyond the homography is curved within a cell; a polynomial that follows it keeps
the mean from being biased by that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.arrays import Bools, Floats, Ints
from calib.homography import (
    FACES,
    TooFewMatchesError,
    dehomogenise,
    dlt_gram,
    homogeneous,
    homography_from_gram,
    normalisation,
)
from calib.matches import Matches
from calib.pieces import by_columns, in_pieces
from calib.polynomial import CONIC, TERMS, monomials

# The median length of a 2-D normal deviate, in its sigmas: sqrt(2 ln 2).
MEDIAN_LENGTH = 1.1774

_CELLS_PER_PLANE = 200
_SAMPLE = 20_000
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
    matches that were left out as outliers.
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

    def as_matches(self) -> Matches:
        """The means on the faces as matches."""
        return Matches(self.camera_px, self.projector_px, np.where(self.plane < len(FACES), self.plane, -1))

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
    """The cells of both; noise and rejected share are those of the first."""
    return replace(
        a,
        camera_px=np.concatenate([a.camera_px, b.camera_px]),
        projector_px=np.concatenate([a.projector_px, b.projector_px]),
        plane=np.concatenate([a.plane, b.plane]),
        sigma_px=np.concatenate([a.sigma_px, b.sigma_px]),
        coarseness=np.concatenate([a.coarseness, b.coarseness]),
    )


@dataclass(frozen=True)
class _Raster:
    """Square cells of `side` pixels from `low` (2,); `columns` × `rows` of them."""

    low: Floats
    side: float
    columns: int
    rows: int

    def number(self, camera_px: Floats) -> Ints:
        """Number of the cell (N,) of each pixel (N, 2)."""
        place = ((camera_px - self.low) / self.side).astype(np.int32)
        number: Ints = np.asarray(place[:, 1] * self.columns + place[:, 0], np.int32)
        return number


@dataclass(frozen=True)
class _Reference:
    """What is expected of a match on a plane: a homography and, in `coefficients` (TERMS, 2), a polynomial on top.

    `scale`: the normalisation of camera pixels. `sigma`: scatter of the sample around it, for weight 1.
    """

    homography: Floats
    scale: Floats
    coefficients: Floats
    sigma: float

    def straight(self, camera_px: Floats) -> Floats:
        """The homography's part, (N, 2)."""
        mapped = self.homography[:, :2] @ camera_px.T + self.homography[:, 2:]
        straight: Floats = mapped[:2] / mapped[2]
        return straight.T

    def curved(self, camera_px: Floats) -> Floats:
        """The polynomial's part, (N, 2)."""
        curved: Floats = self.coefficients.T @ monomials(camera_px, self.scale).T
        return curved.T


def into_cells(matches: Matches, labels: Sequence[int] = FACES) -> Cells:
    """Average the matches with each label over cells, without those that deviate from the others around them.

    Raises TooFewMatchesError if a label has fewer than four.
    """
    if matches.face is None:
        raise ValueError("these matches have no face labels")
    members = [np.flatnonzero(matches.face == label) for label in labels]
    for label, some in zip(labels, members, strict=True):
        if len(some) < 4:
            raise TooFewMatchesError(f"face {label} has {len(some)} matches; a homography needs at least four")
    typical = 1.0
    if matches.sigma_px is not None:
        typical = float(np.median(np.concatenate([matches.sigma_px[some] for some in members])))
    means = [_plane_cells(label, matches, some, typical) for label, some in zip(labels, members, strict=True)]
    squares, freedom = (sum(mean.scatter[i] for mean in means) for i in (0, 1))
    noise = max(float(np.sqrt(squares / max(freedom, 1.0))), 1e-6)
    kept = sum(mean.kept for mean in means)
    return Cells(
        np.concatenate([mean.camera_px for mean in means]),
        np.concatenate([mean.projector_px for mean in means]),
        np.concatenate([mean.plane for mean in means]),
        noise / np.sqrt(np.concatenate([mean.weight for mean in means])),
        np.concatenate([mean.coarseness for mean in means]),
        noise,
        1.0 - kept / sum(len(some) for some in members),
    )


@dataclass(frozen=True)
class _Means:
    """Of one plane, by cells (M,); `scatter`: sum of squared deviations of both coordinates, degrees of freedom."""

    camera_px: Floats
    projector_px: Floats
    plane: Ints
    weight: Floats
    coarseness: Floats
    scatter: tuple[float, float]
    kept: int


def _plane_cells(label: int, matches: Matches, members: Ints, typical_sigma_px: float) -> _Means:
    sample = matches[members[:: max(1, len(members) // _SAMPLE)]]
    reference = _reference(sample, typical_sigma_px)
    raster = _raster(matches.camera_px, members)

    def sums_of(at: slice) -> Floats:
        return _sums(_columns_of(matches, members[at]), reference, raster, typical_sigma_px)

    sums = sum(in_pieces(len(members), sums_of), np.zeros((7, raster.columns * raster.rows)))
    count, weight = sums[0], sums[1]
    # A cell far emptier than the one that a typical match is in holds stray labels, not a piece of the plane.
    full = np.sort(count[count > 0])
    typical = full[np.searchsorted(np.cumsum(full), full.sum() / 2)]
    filled = np.flatnonzero(count >= max(1.0, _SPARSE * typical))
    count, weight = count[filled], weight[filled]
    camera_px = (sums[2:4, filled] / weight).T
    offset = (sums[4:6, filled] / weight).T
    return _Means(
        camera_px,
        reference.straight(camera_px) + offset - _bias(sample, reference, raster)[filled],
        np.full(len(filled), label, np.int32),
        weight,
        np.sqrt(count / weight),
        (float(sums[6, filled].sum()), max(2.0 * count.sum() - 2 * TERMS, 1.0)),
        int(count.sum()),
    )


def _columns_of(matches: Matches, members: Ints) -> Matches:
    """A piece of the matches, column by column in memory."""
    camera_px, projector_px = (
        by_columns(pixels.take(members, axis=0)) for pixels in (matches.camera_px, matches.projector_px)
    )
    sigma_px = None if matches.sigma_px is None else matches.sigma_px[members].astype(np.float64)
    return Matches(camera_px, projector_px, sigma_px=sigma_px)


def _sums(part: Matches, reference: _Reference, raster: _Raster, typical_sigma_px: float) -> Floats:
    """By cells: number, weight, weighted sums of pixels (2) and of offsets from the homography (2), squares; (7, n)."""
    offset = part.projector_px - reference.straight(part.camera_px)
    deviation = offset - reference.curved(part.camera_px)
    weight = np.ones(len(part)) if part.sigma_px is None else (typical_sigma_px / part.sigma_px) ** 2
    square = weight * np.sum(deviation * deviation, axis=1)
    weight[square > (_OUTLIER_SIGMAS * reference.sigma) ** 2] = 0.0
    square *= weight > 0
    cell, size = raster.number(part.camera_px), raster.columns * raster.rows
    rows = [weight > 0, weight, *(weight * part.camera_px.T), *(weight * offset.T), square]
    return np.stack([np.bincount(cell, row, minlength=size) for row in rows])


def _bias(sample: Matches, reference: _Reference, raster: _Raster) -> Floats:
    """By how much the polynomial's mean over a cell's matches exceeds its value at their mean, (cells, 2)."""
    cell, size = raster.number(sample.camera_px), raster.columns * raster.rows
    count = np.maximum(np.bincount(cell, minlength=size), 1)[:, None]

    def mean(values: Floats) -> Floats:
        return np.stack([np.bincount(cell, column, minlength=size) for column in values.T], axis=1) / count

    return mean(reference.curved(sample.camera_px)) - reference.curved(mean(sample.camera_px))


def _reference(sample: Matches, typical_sigma_px: float) -> _Reference:
    """Homography and polynomial through a plane's matches, whatever a minority of them says."""
    weight = np.ones(len(sample)) if sample.sigma_px is None else (typical_sigma_px / sample.sigma_px) ** 2
    inside = _near_a_homography(sample)
    homography = _homography(sample.camera_px[inside], sample.projector_px[inside])
    offset = sample.projector_px - dehomogenise(homogeneous(sample.camera_px) @ homography.T)
    scale = normalisation(sample.camera_px)
    terms = monomials(sample.camera_px, scale)
    if inside.sum() < 3 * TERMS:
        terms[:, CONIC:] = 0.0  # too few matches for more
    for _ in range(_CUTS):
        root = np.sqrt(weight[inside])[:, None]
        coefficients: Floats = np.linalg.lstsq(terms[inside] * root, offset[inside] * root, rcond=1e-10)[0].astype(
            np.float64
        )
        size = np.linalg.norm(offset - terms @ coefficients, axis=1) * np.sqrt(weight)
        # A polynomial through few matches follows them; its freedom is given back.
        freedom = max(1.0 - np.count_nonzero(terms.any(axis=0)) / max(inside.sum(), 1), 0.1)
        sigma = max(float(np.median(size[inside])) / MEDIAN_LENGTH / np.sqrt(freedom), 1e-9)
        inside = size <= _OUTLIER_SIGMAS * sigma
    return _Reference(homography, scale, coefficients, sigma)


def _near_a_homography(sample: Matches) -> Bools:
    """Matches (N,) that one homography explains as well as it does most (least median of squares)."""
    every = np.ones(len(sample), bool)
    few = sample[:: max(1, len(sample) // _SMALL_SAMPLE)]
    homography, _ = cv2.findHomography(few.camera_px, few.projector_px, cv2.LMEDS) if len(few) > 4 else (None, None)
    if homography is None:
        return every
    mapped = dehomogenise(homogeneous(sample.camera_px) @ np.asarray(homography, np.float64).T)
    size = np.linalg.norm(sample.projector_px - mapped, axis=1)
    near: Bools = size <= 2 * _OUTLIER_SIGMAS * np.median(size) / MEDIAN_LENGTH
    return near


def _homography(camera_px: Floats, projector_px: Floats) -> Floats:
    camera, projector = normalisation(camera_px), normalisation(projector_px)
    gram = dlt_gram(
        dehomogenise(homogeneous(camera_px) @ camera.T), dehomogenise(homogeneous(projector_px) @ projector.T)
    )
    homography: Floats = np.linalg.inv(projector) @ homography_from_gram(gram) @ camera
    return homography


def _raster(camera_px: Floats, members: Ints) -> _Raster:
    low, high = (
        np.array([end(camera_px[:, axis].take(members)) for axis in (0, 1)], np.float64) for end in (np.min, np.max)
    )
    # The share of the bounding box that a face fills is unknown; half is typical of a corner's faces.
    side = max(1.0, float(np.sqrt(np.prod(np.maximum(high - low, 1.0)) / (2 * _CELLS_PER_PLANE))))
    columns, rows = (int(extent // side) + 1 for extent in high - low)
    return _Raster(low, side, columns, rows)
