"""Cameras, lenses, poses, homographies, the cuboid corner, triangulation: formulas, and nothing that is estimated."""

from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.corner import Corner, CornerImage, corner_image, corner_planes, leg_signs
from calib.geometry.homography import (
    FACES,
    FaceGrams,
    TooFewMatchesError,
    dehomogenise,
    face_grams,
    homogeneous,
    homography_between,
    mapped,
    normalisation,
)
from calib.geometry.matches import NO_FACE, Matches
from calib.geometry.radial_distortion import project, unproject
from calib.geometry.relative_pose import Motion, cross, rotation_about, tangent_basis
from calib.geometry.reprojection_error import before_the_matches
from calib.geometry.triangulation import intersect, intersect_rays, nearest_depths
