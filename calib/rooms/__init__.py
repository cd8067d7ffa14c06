"""Whole rooms: the poses of several stations of one rig, their common planes, and one joint estimate."""

from calib.rooms.dense_check import SurfaceDisplacement, TurnedRig, changed_extrinsics, disagreements
from calib.rooms.estimate import RoomEstimate, Undetermined, estimate_room
from calib.rooms.factors import Patch
from calib.rooms.lengths import Measured, RoomPoint, angle_deg, centre_of, distance, gap, vertex
from calib.rooms.point_tracking import LabelledPicture
from calib.rooms.priors import RigPrior, RoomPrior
from calib.rooms.room import Room
from calib.rooms.without_planes import estimate_without_planes
