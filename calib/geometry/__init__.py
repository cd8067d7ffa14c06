"""Cameras, lenses, poses, homographies, the cuboid corner, triangulation: closed-form geometry, no estimation."""

from calib.geometry.calibration import Calibration, DeviceSigmas, Sigmas
from calib.geometry.camera import Intrinsics, Size
from calib.geometry.corner import (
    Corner,
    CornerImage,
    corner_image,
    corner_planes,
    depths_on_planes,
    inverse_depths,
    leg_signs,
    polar,
)
from calib.geometry.epipolar_line import cross_epipolar_lines
from calib.geometry.homography import (
    FaceGrams,
    TooFewMatchesError,
    dehomogenise,
    face_grams,
    homogeneous,
    homography_between,
    mapped,
)
from calib.geometry.matches import FACES, NO_FACE, Matches
from calib.geometry.pixel_grid import SQUARE_PIXELS, PixelGrid
from calib.geometry.plane import PER_PLANE, Plane
from calib.geometry.pose import (
    IDENTITY,
    PER_POSE,
    Pose,
    cross,
    cross_matrix,
    dot,
    nearest_rotation,
    rotation_about,
    rotation_vector,
    tangent_basis,
)
from calib.geometry.radial_distortion import (
    Distortion,
    Pinhole,
    distorted_point,
    project,
    project_into,
    rescaled,
    rescaled_by_lens,
    rescaled_point,
    unproject,
    unproject_into,
)
from calib.geometry.triangulation import (
    Intersections,
    before_the_matches,
    depths_of_rays,
    depths_on_stripes,
    intersect,
    intersect_rays,
    midpoints,
    nearest_depths,
)
