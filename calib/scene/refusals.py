"""Why stations of a scene do not calibrate a rig, and what would help."""

from collections.abc import Sequence

import numpy as np

from calib.diagnostics import Uncertainty
from calib.finding import FindingKind
from calib.geometry import Pose, rotation_vector
from calib.refinement import CAMERA, PROJECTOR
from calib.refusal import RefusalError
from calib.scene.problem import SceneFit, SceneProblem

_ONE_AXIS_DEG = 3.0  # rotations that turn by less about all other axes leave a coordinate open
_MOST_FOCAL = 0.015  # relative sigma of a focal length
# Sigmas of a match between a point and the surface that another station sees, each found by 49 of them. Right rigs have
# 0.28 to 0.3 (benchmarks/bench_anything.py), wrong ones that explain the keypoints of three stations 0.5 to 2.
_MOST_APART = 0.8

TOO_FEW_STATIONS = FindingKind(
    "too-few-stations",
    "Without a corner or a board, fewer than three stations do not determine a calibration.",
    "Take three or more captures: move the rig, or turn and tip what stands before it, by 10 to 30° each time.",
)
NOTHING_MOVED = FindingKind(
    "nothing-moved",
    "The stations of a calibration see the same things at the same places.",
    "Move the rig, or turn and tip what stands before it, by 10 to 30° between the captures.",
)
NO_COMMON_POINTS = FindingKind(
    "no-common-points",
    "The pictures of a calibration's stations have too few points in common.",
    "Move or turn less from one capture to the next, 10 to 30°, and let something with a pattern be in the picture: "
    "books, boxes with print, scraps of newspaper.",
    data=("points", "captures"),
)
ONE_AXIS = FindingKind(
    "turns-about-one-axis",
    "All rotations between the stations of a calibration are about one axis, which leaves the principal points open.",
    "Tip the object once, on its side for instance, or roll the rig once by 20° or more, and take one more capture.",
    data=("axes_deg",),
)
APART = FindingKind(
    "surfaces-bent",
    "Under no calibration do the surfaces that captures share coincide.",
    "Check that nothing of the rig changed between the captures, zoom and focus included, and that what stands before "
    "it kept its shape. Otherwise take more captures, turned less from one to the next.",
    data=("noise_ratio",),
)
UNDETERMINED = FindingKind(
    "scene-undetermined",
    "The stations of a calibration determine the focal lengths too weakly.",
    "Take more captures, turned about different axes by 10 to 30° each, with more of a pattern in the picture.",
    data=("camera_focal_percent", "projector_focal_percent"),
)
SLIDING = FindingKind(
    "surfaces-slide",
    "Pictures have no points in common, and the surfaces of stations fit each other in more than one way.",
    "Let something with a pattern be in the picture: books, boxes with print, scraps of newspaper. Shapes calibrate a "
    "rig where they are irregular, as balls, bottles and flat things are not.",
    data=("captures",),
)
AMBIGUOUS = FindingKind(
    "scene-ambiguous",
    "Two different calibrations explain the stations almost equally well.",
    "Take more captures, turned about different axes by 10 to 30° each.",
    data=("cost", "focal_percent"),
)


def _refuse_apart(problem: SceneProblem) -> None:
    """Raise if the surfaces of the stations do not coincide: a wrong rig bends each in its own way."""
    if problem.spread.lifted > _MOST_APART:
        raise RefusalError(
            APART,
            f"The surfaces that the captures share are {problem.spread.lifted:.1f} times as far apart as their matches "
            "are noisy, so that no rig explains them.",
            APART.remedy,
            {"noise_ratio": problem.spread.lifted},
        )


def refuse_undetermined(problem: SceneProblem, fit: SceneFit, uncertainty: Uncertainty) -> None:
    """Raise if surfaces do not coincide, the stations turn about one axis, or focal lengths are known too weakly."""
    _refuse_apart(problem)
    _refuse_one_axis(fit.scene.stations)
    sigma = np.sqrt(np.diag(uncertainty.covariance))
    percent = 100 * sigma[CAMERA.start], 100 * sigma[PROJECTOR.start]
    if not max(percent) < 100 * _MOST_FOCAL:
        raise RefusalError(
            UNDETERMINED,
            f"The focal lengths are only known to ± {percent[0]:.1f} % (camera) and ± {percent[1]:.1f} % (projector).",
            UNDETERMINED.remedy,
            {"camera_focal_percent": float(percent[0]), "projector_focal_percent": float(percent[1])},
        )


def nothing_common(points: int, stations: int, captures: int) -> RefusalError:
    """A refusal of captures of which so many `stations` have so many `points` in common."""
    return RefusalError(
        NO_COMMON_POINTS,
        f"The pictures of the {captures} captures have too few points in common: {points} in {stations} of them.",
        NO_COMMON_POINTS.remedy,
        {"points": float(points), "captures": float(stations)},
    )


def _refuse_one_axis(stations: Sequence[Pose]) -> None:
    """Raise if all rotations from the first station are about one axis, as a turntable's are."""
    vectors = rotation_vector(np.stack([pose.rotation for pose in stations[1:]]))
    axes = np.linalg.svd(vectors)[2]
    off_deg = float(np.degrees(np.linalg.norm(vectors @ axes[1:].T, axis=1).max()))
    if off_deg < _ONE_AXIS_DEG:
        raise RefusalError(
            ONE_AXIS,
            f"All rotations between the {len(stations)} captures are about one axis, but for {off_deg:.1f}°, which "
            "leaves the principal points along it open.",
            ONE_AXIS.remedy,
            {"axes_deg": off_deg},
        )
