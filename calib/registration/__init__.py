"""Registration: how views of one scene fit together, by planes, keypoints and shape, without a first guess."""

from calib.registration.alignment import couple_poses
from calib.registration.hypotheses import fit_rigid_motion
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
from calib.registration.range_view import StationView, pixel_under, rotate_vector, sample_evenly, station_view
from calib.registration.register import (
    NO_OVERLAP,
    NOTHING_SEEN,
    Group,
    Pair,
    Registration,
    UnregisteredStation,
    register,
)
from calib.registration.segments import relative_noise
from calib.registration.straight_planes import split_planes
