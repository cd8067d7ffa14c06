"""Whole rooms: the poses of several stations of one rig, their common planes, and one joint estimate."""

from calib.rooms.changed_extrinsics import TurnedRig, changed_extrinsics
from calib.rooms.dense_check import SurfaceDisplacement, disagreements
from calib.rooms.estimate import RoomEstimate, Undetermined, estimate_room
from calib.rooms.lengths import Measured, RoomPoint, angle_deg, centre_of, distance, gap, vertex
from calib.rooms.marks import Marks, marks_of
from calib.rooms.misfits import ANOTHER_ROOM, SOMETHING_MOVED
from calib.rooms.patches import Patch
from calib.rooms.point_tracking import LabelledPicture
from calib.rooms.priors import RigPrior, RoomPrior
from calib.rooms.registration import (
    NO_OVERLAP,
    NOTHING_SEEN,
    AlternativePlaces,
    Group,
    Pair,
    Registration,
    UnregisteredStation,
    register,
)
from calib.rooms.room import Room
from calib.rooms.segments import relative_noise
from calib.rooms.station import StationView, station_view
from calib.rooms.straight_planes import split_planes
from calib.rooms.without_planes import estimate_without_planes
