"""Whole rooms: the poses of several stations of one rig, their common planes, and one joint estimate."""

from calib.rooms.changed_extrinsics import TurnedRig, changed_extrinsics
from calib.rooms.dense_check import Disagreement, disagreements
from calib.rooms.estimate import RoomEstimate, Undetermined, estimate_room
from calib.rooms.marks import Marks, marks_of
from calib.rooms.planes import RoomPlane
from calib.rooms.point_tracking import Sight
from calib.rooms.priors import RigPrior
from calib.rooms.registration import Alternative, Group, LeftOut, Pair, Registration, register
from calib.rooms.room import Room
from calib.rooms.station import StationView, station_view
from calib.rooms.straight_planes import split_planes
from calib.rooms.without_planes import estimate_without_planes
