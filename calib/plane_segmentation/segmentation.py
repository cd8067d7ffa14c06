"""Surfels → planes of one scene, with the epipolar geometry and the lenses that they share."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import Floats, Ints
from calib.plane_segmentation.fundamental_matrix import first_geometry, largest_plane
from calib.plane_segmentation.planar_bundle_adjustment import refine
from calib.plane_segmentation.plane_extraction import covariances, find_planes, spill, without_uneven
from calib.plane_segmentation.plane_parallax import TwoView
from calib.plane_segmentation.surfels import Surfels, gather_evidence

# Initial standard deviations of the errors of lens model, decoder and uneven walls: the first that explains whole
# surfaces is used, and then replaced by the measured one.
_FIRST_MODELS_PX = (0.15, 0.6, 2.4)
_LEAST_MODEL_PX = 0.05
_MOST_SPILL = 0.25
# So much of a picture is a face that was dropped for being uneven: behind a lens out of focus dark ones are noisier.
_MUCH_UNEVEN = 0.1


@dataclass(frozen=True)
class Segments:
    """`planes` (n, 3), largest first, and their `covariance` (n, 3, 3); `label` (M,): the plane of each surfel;
    `model_px`: standard deviation of the surfels about their planes beyond their noise; `spill` and `uneven`, the
    largest share of the surfels that lay on a plane which was dropped, as in plane_extraction.py.
    """

    view: TwoView
    planes: Floats
    covariance: Floats
    label: Ints
    model_px: float
    spill: float
    uneven: float

    def about(self, point: tuple[float, float]) -> "Segments":
        """The same planes of ideal camera coordinates that have their origin at this point."""
        from_point = np.array([[1.0, 0.0, point[0]], [0.0, 1.0, point[1]], [0.0, 0.0, 1.0]])
        return replace(
            self,
            view=replace(self.view, base=self.view.base @ from_point),
            planes=self.planes @ from_point,
            covariance=from_point.T @ self.covariance @ from_point,
        )


def segmentations(
    surfels: Surfels, camera_size: tuple[int, int], projector_size: tuple[int, int], rng: np.random.Generator
) -> Iterator[Segments]:
    """Yield the planes at the tightest tolerance that does not cut surfaces into slices, or that does so least.

    Then, in case these form no corner, yield those at each wider tolerance, as long as the previous one dropped a large
    plane as uneven.
    """
    view = first_geometry(surfels, largest_plane(surfels, camera_size, projector_size, rng), rng)
    candidates: list[Segments] = []
    models_px = iter(_FIRST_MODELS_PX)
    for model_px in models_px:
        candidates.append(_segment_within(surfels, view, model_px, rng))
        if candidates[-1].spill < _MOST_SPILL:
            break
    last = min(candidates, key=lambda segments: segments.spill)
    yield last
    for model_px in models_px:
        if last.uneven < _MUCH_UNEVEN:
            return
        last = _segment_within(surfels, view, model_px, rng)
        yield last


def _segment_within(surfels: Surfels, view: TwoView, model_px: float, rng: np.random.Generator) -> Segments:
    evidence = gather_evidence(surfels, view, model_px)
    planes, label = find_planes(surfels, evidence, rng)
    if len(planes) > 0:
        # With both lenses refined on the planes, the tolerance can be tight enough to separate nearly coplanar planes.
        view, planes = refine(surfels, label, view, planes, 2 * model_px, rng)
        evidence = gather_evidence(surfels, view, model_px)
        off_px = np.abs(evidence.off_own(planes, label) * evidence.sigma)[label >= 0]
        model_px = max(_LEAST_MODEL_PX, 1.5 * float(np.median(off_px)))
        evidence = gather_evidence(surfels, view, model_px)
        planes, label = find_planes(surfels, evidence, rng)
    sliced = spill(evidence, planes, label)
    planes, label, uneven = without_uneven(evidence, planes, label)
    if len(planes) > 0:
        view, planes = refine(surfels, label, view, planes, 2 * model_px, rng)
        evidence = gather_evidence(surfels, view, model_px)
    return Segments(view, planes, covariances(evidence, label, len(planes)), label, model_px, sliced, uneven)
