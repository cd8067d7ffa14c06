"""Many matches on a face → few equivalent ones, so that the refinement costs the same for 10⁴ and 10⁷ matches.

Within a cell of some twenty camera pixels what a face's homography does not explain (lens distortion, decoding errors)
is as good as constant, so the mean deviation from the homography, put back at the cell's mean, carries everything that
the cell's matches say; its scatter says how well.
"""

from dataclasses import dataclass

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

# The median length of a 2-D normal deviate, in its sigmas: sqrt(2 ln 2).
MEDIAN_LENGTH = 1.1774

_CELLS_PER_FACE = 400
_FIRST_PASS = 20_000
_SPARSE = 0.2
_OUTLIER_SIGMAS = 4.0


@dataclass(frozen=True)
class Cells:
    """Means of matches over cells of the camera image.

    `camera_px`, `projector_px`: (M, 2). `face`, `column`, `row`: (M,) the face and the place in that face's raster of
    cells. `sigma_px`: (M,) standard error of each coordinate of `projector_px` if matches err independently.
    `noise_px`: scatter of a single match. `rejected`: share of matches that were left out as outliers.
    """

    camera_px: Floats
    projector_px: Floats
    face: Ints
    column: Ints
    row: Ints
    sigma_px: Floats
    noise_px: float
    rejected: float

    def __len__(self) -> int:
        return len(self.face)

    def as_matches(self) -> Matches:
        """The means as matches."""
        return Matches(self.camera_px, self.projector_px, self.face, self.sigma_px)

    def __getitem__(self, chosen: Bools | slice) -> "Cells":
        """The cells at a mask or slice."""
        return Cells(
            self.camera_px[chosen],
            self.projector_px[chosen],
            self.face[chosen],
            self.column[chosen],
            self.row[chosen],
            self.sigma_px[chosen],
            self.noise_px,
            self.rejected,
        )


@dataclass(frozen=True)
class _FaceCells:
    camera_px: Floats
    projector_px: Floats
    column: Ints
    row: Ints
    count: Ints
    deviation: Floats
    kept: Bools
    homography: Floats


def into_cells(matches: Matches) -> Cells:
    """Average the matches of the faces 0, 1, 2 over cells, leaving out those that deviate from their cell's median.

    Raises TooFewMatchesError if a face has fewer than four.
    """
    faces = [_face_cells(matches.on_face(label)) for label in FACES]
    kept = np.concatenate([face.kept for face in faces])
    deviation = np.concatenate([face.deviation for face in faces])[kept]
    freedom = max(1, len(deviation) - sum(len(face.count) for face in faces))
    noise = float(np.sqrt(np.sum(deviation**2) / (2 * freedom)))
    count = np.concatenate([face.count for face in faces])
    return Cells(
        np.concatenate([face.camera_px for face in faces]),
        np.concatenate([face.projector_px for face in faces]),
        np.repeat(np.array(FACES, np.int32), [len(face.count) for face in faces]),
        np.concatenate([face.column for face in faces]),
        np.concatenate([face.row for face in faces]),
        np.maximum(noise, 1e-6) / np.sqrt(count),
        noise,
        float(1 - kept.mean()),
    )


def _face_cells(face: Matches) -> _FaceCells:
    """Two passes: wrong matches spoil a homography through all of them, but not one through the cells' means."""
    if len(face) < 4:
        raise TooFewMatchesError(f"a face has {len(face)} matches; a homography needs at least four")
    first = face[:: max(1, len(face) // _FIRST_PASS)]
    rough = _averaged(first, _homography(first.camera_px, first.projector_px))
    return _averaged(
        face, _homography(rough.camera_px, rough.projector_px) if len(rough.count) >= 4 else rough.homography
    )


def _homography(camera_px: Floats, projector_px: Floats) -> Floats:
    camera, projector = normalisation(camera_px), normalisation(projector_px)
    gram = dlt_gram(
        dehomogenise(homogeneous(camera_px) @ camera.T), dehomogenise(homogeneous(projector_px) @ projector.T)
    )
    homography: Floats = np.linalg.inv(projector) @ homography_from_gram(gram) @ camera
    return homography


def _averaged(face: Matches, homography: Floats) -> _FaceCells:
    residual = face.projector_px - dehomogenise(homogeneous(face.camera_px) @ homography.T)
    column, row, cell = _raster(face.camera_px)
    cells, first, index, count = np.unique(cell, return_index=True, return_inverse=True, return_counts=True)
    deviation = residual - _medians(residual, index, count)[index]
    size = np.linalg.norm(deviation, axis=1)
    limit = _OUTLIER_SIGMAS * max(float(np.median(size)) / MEDIAN_LENGTH, 1e-9)
    kept = size <= limit

    weight = np.bincount(index[kept], minlength=len(cells))
    # A cell far emptier than the one that a typical match is in holds stray labels, not a piece of the face.
    filled = weight >= max(1.0, _SPARSE * float(np.median(count[index])))
    kept &= filled[index]

    def mean(values: Floats) -> Floats:
        sums = [np.bincount(index[kept], values[kept, axis], minlength=len(cells)) for axis in (0, 1)]
        means: Floats = np.stack(sums, axis=1)[filled] / weight[filled, None]
        return means

    centre, offset = mean(face.camera_px), mean(residual)
    place = np.cumsum(filled) - 1
    return _FaceCells(
        centre,
        dehomogenise(homogeneous(centre) @ homography.T) + offset,
        column[first][filled],
        row[first][filled],
        weight[filled],
        np.linalg.norm(residual - offset[place[index]], axis=1),
        kept,
        homography,
    )


def _raster(camera_px: Floats) -> tuple[Ints, Ints, Ints]:
    """Column, row and number of the square cell that each match (N, 2) falls into."""
    low, high = camera_px.min(axis=0), camera_px.max(axis=0)
    # The share of the bounding box that a face fills is unknown; half is typical of a corner's faces.
    side = max(1.0, float(np.sqrt(np.prod(np.maximum(high - low, 1.0)) / (2 * _CELLS_PER_FACE))))
    place = np.floor((camera_px - low) / side).astype(np.int32)
    columns = int(place[:, 0].max()) + 1
    return place[:, 0], place[:, 1], place[:, 1] * columns + place[:, 0]


def _medians(values: Floats, index: Ints, count: Ints) -> Floats:
    """Median of each coordinate of `values` (N, 2) over each group of `index` (N,); `count` is the groups' sizes."""
    middle = np.cumsum(count) - (count + 1) // 2
    medians = []
    for axis in (0, 1):
        order = np.lexsort((values[:, axis], index))
        medians.append(values[order[middle], axis])
    return np.stack(medians, axis=1)
