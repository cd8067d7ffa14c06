"""Errors of the poses of several scans in one frame, and of numbers computed from points of different scans."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics.error_propagation import Budget, SystematicErrors, spread_of_points
from calib.geometry import PER_POSE, Matches, Pose, cross_matrix, intersect
from calib.numerics import Floats
from calib.refinement import SHARED


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of poses (n) in a common frame, as motions (ω, s): a point X of that scan moves by ω × X + s.

    What all poses share, and errors of the calibration that the poses follow, does not blur distances between scans.
    """

    covariance: Floats
    """(6 n, 6 n), for a given calibration."""
    by_calibration: Floats
    """(6 n, 21): derivatives by the calibration's columns, as of `Uncertainty`."""

    @classmethod
    def from_joint(cls, covariance: Floats, motions: Sequence[Floats]) -> "PoseErrors":
        """From the covariance (21 + 6 n, 21 + 6 n) of the calibration's columns and of n poses' columns, and the
        matrices (6, 6) that make a motion of each pose's columns.
        """
        of_rig = covariance[:SHARED, :SHARED]
        scale = np.sqrt(of_rig.diagonal())
        scale = np.where(scale > 0, scale, 1.0)
        inverse = np.linalg.pinv(of_rig / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
        by_rig = covariance[SHARED:, :SHARED] @ inverse
        rest = covariance[SHARED:, SHARED:] - by_rig @ covariance[:SHARED, SHARED:]
        to_motions = np.zeros_like(rest)
        for i, motion in enumerate(motions):
            part = slice(PER_POSE * i, PER_POSE * (i + 1))
            to_motions[part, part] = motion
        return cls(to_motions @ rest @ to_motions.T, to_motions @ by_rig)


def budget_across(
    matches: Matches,
    sigma_px: Floats,
    places: Sequence[Pose],
    stations: Sequence[int],
    gradient: Floats,
    errors: SystematicErrors,
    poses: PoseErrors | None,
) -> Budget:
    """The budget of a number that depends on points (N) of scans with known poses by its `gradient` (N, 3) in their
    common frame: `matches` (N), their `sigma_px` (N,), and the pose and the number of the scan of each.

    All scans share the calibration's `errors`; `poses` is None where all points are of one scan.
    """
    in_camera = np.concatenate([place.rotation.T @ part for place, part in zip(places, gradient, strict=True)])
    spread = spread_of_points(matches, errors, sigma_px).through(in_camera[None])
    systematic = spread.systematic[0].copy()
    # The scale moves the cameras, too.
    origins = np.stack([place.translation for place in places])
    systematic += float(np.sum(gradient * origins)) * errors.log_scale
    variance = 0.0
    if poses is not None:
        points = intersect(matches, errors.calibration).points
        by_motion = np.zeros(len(poses.covariance))
        for point, place, station, part in zip(points, places, stations, gradient, strict=True):
            moved = cross_matrix(place @ point) @ part  # ω × X · g = ω · (X × g)
            by_motion[PER_POSE * station : PER_POSE * (station + 1)] += np.concatenate([moved, part])
        systematic += errors.steps @ (by_motion @ poses.by_calibration)
        variance = float(by_motion @ poses.covariance @ by_motion)
    of_number = replace(spread, systematic=systematic[None]).budget()
    return replace(of_number, poses=float(np.sqrt(max(variance, 0.0))))
