"""Whole rooms: where several stations of one rig stood, and the planes that they share."""

from calib.rooms.planes import RoomPlane
from calib.rooms.registration import Alternative, Group, LeftOut, Pair, Registration, register
from calib.rooms.station import StationView, station_view
