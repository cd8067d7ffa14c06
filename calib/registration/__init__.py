"""Registration: how views of one scene fit together, by planes, keypoints and shape, without a first guess."""

from calib.registration.alignment import couple_places, step_places
from calib.registration.changes import Change, find_changes
from calib.registration.deviations import (
    CellDeviations,
    Deviations,
    Region,
    find_regions,
    from_mesh,
    from_samples,
    groups,
    inflated,
)
from calib.registration.free_space import FreeSpace
from calib.registration.keypoint_votes import fit_rigid_motion, voted_poses
from calib.registration.keypoints import (
    Keypoints,
    describe_keypoints,
    find_keypoints,
    for_hellinger,
    log_brightness,
    match_keypoints,
    mutual_matches,
    no_keypoints,
    rectify_texture,
    sift,
)
from calib.registration.outlier_stations import ANOTHER_ROOM, SOMETHING_MOVED
from calib.registration.plane_step import add_pair, step_pose
from calib.registration.pose_graph import PairPose, PoseGraph, solve_pose_graph
from calib.registration.pose_samples import distinct_poses, even_rotations
from calib.registration.projection import (
    HIDDEN,
    OFF_SURFACE,
    THROUGH_FREE_SPACE,
    UNSEEN,
    Gates,
    Patches,
    RangeImage,
    classify,
    descend,
)
from calib.registration.range_view import StationView, sample_evenly, station_view
from calib.registration.register import (
    NO_OVERLAP,
    NOTHING_SEEN,
    Group,
    Pair,
    Registration,
    UnregisteredStation,
    register,
)
from calib.registration.sampled_surface import (
    SampledSurface,
    extent_of,
    local_noise,
    measured_noise,
    sample_mesh,
    sample_surface,
    spacing_of,
)
from calib.registration.segments import relative_noise
from calib.registration.straight_planes import split_planes
from calib.registration.surface_evidence import SurfacePose
from calib.registration.surface_fit import FreeMotion
from calib.registration.surface_pair import SurfacePoints
from calib.registration.surface_registration import Alignment, SurfaceRegistration, register_surfaces
