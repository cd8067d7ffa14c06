"""Registration: how views of one scene fit together, by planes, keypoints and shape, without a first guess."""

from calib.registration.deviations import (
    CellDeviations,
    Change,
    Deviations,
    Region,
    find_changes,
    find_regions,
    from_mesh,
    from_samples,
    groups,
    inflated,
)
from calib.registration.group_evidence import ANOTHER_ROOM, SOMETHING_MOVED
from calib.registration.keypoints import (
    Keypoints,
    describe_keypoints,
    find_keypoints,
    fit_rigid_motion,
    for_hellinger,
    log_brightness,
    match_keypoints,
    mutual_matches,
    no_keypoints,
    rectify_texture,
    sift,
    voted_poses,
)
from calib.registration.pose_graph import (
    PairPose,
    PoseGraph,
    adjust_places,
    couple_places,
    grow_groups,
    solve_pose_graph,
    supposed_places,
)
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
from calib.registration.range_view import StationView, sample_evenly, split_planes, station_view
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
    are_opposed,
    cell_numbers,
    enclosed_volume,
    extent_of,
    is_closed,
    local_noise,
    sample_mesh,
    sample_surface,
    spacing_of,
)
from calib.registration.segments import relative_noise
from calib.registration.starting_poses import distinct_poses, even_rotations
from calib.registration.surface_fit import FreeMotion, SurfacePose
from calib.registration.surface_pair import FreeSpace, SurfacePoints
from calib.registration.surface_registration import Alignment, SurfaceRegistration, register_surfaces
