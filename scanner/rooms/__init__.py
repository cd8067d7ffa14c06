"""Whole rooms: stations → the rig, its poses, the walls; and the files for people."""

from scanner.rooms.contents import OutlierStation, SolvedRoom, Station
from scanner.rooms.corner_rig import state_of
from scanner.rooms.epipolar_lines import CHANGED_RIG
from scanner.rooms.floorplan import floor_plan
from scanner.rooms.jobs import StationComparison, scan_room
from scanner.rooms.mesh import CAMERA_FROM_ROOM, blended, blended_of
from scanner.rooms.scene_rig import (
    after_no_corner,
    calibrate_by_pictures,
    guide_without_corner,
    rig_from_placed,
    rig_from_stations,
    start_of,
)
from scanner.rooms.solve import solve_room
from scanner.rooms.textures import part_of
from scanner.rooms.verdict import LOOSE_STATIONS, lower_for_doubts, verdict_on
