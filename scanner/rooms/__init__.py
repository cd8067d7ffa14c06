"""Whole rooms: stations → the rig, its poses, the walls; and the files for people."""

from scanner.rooms.blended_cloud import blended, blended_of
from scanner.rooms.contents import OutlierStation, SolvedRoom, Station
from scanner.rooms.corner_rig import state_of
from scanner.rooms.epipolar_lines import CHANGED_RIG
from scanner.rooms.floorplan import floor_plan
from scanner.rooms.jobs import scan_room
from scanner.rooms.live import StationComparison
from scanner.rooms.mesh import CAMERA_FROM_ROOM
from scanner.rooms.scene_guidance import guide_without_corner
from scanner.rooms.scene_rig import (
    after_no_corner,
    calibrate_by_pictures,
    rig_from_placed,
    rig_from_stations,
    start_of,
)
from scanner.rooms.solve import solve_room
from scanner.rooms.textures import part_of
from scanner.rooms.verdict import LOOSE_STATIONS, lower_for_doubts, verdict_on
