"""Whole rooms: the joint estimate of a rig, its places and the room's planes."""

from calib.rooms.estimate import RoomEstimate, Undetermined, estimate_room
from calib.rooms.likelihood import RigPrior
from calib.rooms.planes import RoomPlane
from calib.rooms.room import Room
