"""A room drawn from a seed: walls, furniture, and a rig with a suitable view of the corner."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.placement import RigGeometry, draw_camera_pose, draw_rig, look, zoomed
from hw.simulated.scene import Label, Scene
from hw.simulated.shapes import Ball, Block
from hw.simulated.whole_room import (
    WholeRoom,
    draw_corner_box,
    draw_furniture,
    draw_second_sphere,
    draw_whole_room,
    overlap,
)

_ATTEMPTS = 3000
_FURNITURE_ATTEMPTS = 300
# Smallest share of the lit pixels on a face of the corner, without and with furniture in front of it.
_BARE_FACE = 0.22
_FURNISHED_FACE = 0.15
_TOUCHING = 0.98  # share of a radius that must be inside the room
_POSE_SPACING_M = 0.35  # smallest distance between poses
# Settings that determine what is drawn; the last rooms are kept, because each capture and each pair of devices asks for
# its own anew.
DRAWN_BY = (
    *("seed", "room", "stations", "distortion", "walls_off_deg", "furniture", "furniture_askew_deg", "hide_vertex"),
    *("sphere_radius_m", "ball_bar_m"),
)
_KEPT = 8

Place = tuple[PlacedDevice, PlacedDevice]


@dataclass(frozen=True)
class DrawnRoom:
    """A scene and the two devices in it."""

    scene: Scene
    camera: PlacedDevice
    projector: PlacedDevice


class _Streams:
    """Independent random numbers for each drawn item, so that its settings leave the other items unchanged."""

    def __init__(self, seed: int) -> None:
        self.walls, self.rig, self.furniture, self.corner_box, self.poses, self.askew, self.ball_bar = (
            np.random.default_rng([seed, stream]) for stream in range(7)
        )


def draw_room(settings: SimulatedRigSettings) -> DrawnRoom:
    """Draw rooms until the view is suitable (`View.is_suitable`).

    The devices have the paper's resolution. Raises DeviceError if the seed has no suitable view or too few poses.
    """
    drawn = SimulatedRigSettings.model_validate({key: getattr(settings, key) for key in DRAWN_BY})
    if settings.room == "whole":
        whole = _whole_room(drawn)
        return DrawnRoom(whole.scene, *_devices(whole.stations, settings))
    scene, rig, first = _corner(drawn)
    places = _draw_poses(scene, rig, first, settings)
    return DrawnRoom(scene, *_devices(places, settings))


@lru_cache(_KEPT)
def _whole_room(settings: SimulatedRigSettings) -> WholeRoom:
    return draw_whole_room(settings, draw_walls(_Streams(settings.seed).walls, settings.walls_off_deg))


@lru_cache(_KEPT)
def _corner(settings: SimulatedRigSettings) -> tuple[Scene, RigGeometry, Place]:
    """The scene, and the rig at its first pose. Raises DeviceError."""
    streams = _Streams(settings.seed)
    walls = draw_walls(streams.walls, settings.walls_off_deg)
    for _ in range(_ATTEMPTS):
        rig = draw_rig(streams.rig, settings.distortion)
        camera, projector = rig.placed(*draw_camera_pose(streams.rig))
        if not look(Scene(walls), camera, projector).is_suitable(_BARE_FACE):
            continue
        scene = _furnish(walls, camera, projector, settings, streams)
        if scene is not None:
            return scene, rig, (camera, projector)
    raise DeviceError(
        f"the simulated rig finds no good view of the corner in its room; use another seed than {settings.seed}"
    )


def _furnish(
    walls: Block, camera: PlacedDevice, projector: PlacedDevice, settings: SimulatedRigSettings, streams: _Streams
) -> Scene | None:
    """The room with furniture that leaves enough of the corner visible; None if none was found."""
    for _ in range(_FURNITURE_ATTEMPTS):
        blocks: tuple[Block, ...] = ()
        sphere: Ball | None = None
        if settings.furniture:
            askew = np.radians(settings.furniture_askew_deg * streams.askew.standard_normal())
            blocks, sphere = draw_furniture(streams.furniture, settings.sphere_radius_m, askew)
        if settings.hide_vertex:
            blocks += (draw_corner_box(streams.corner_box),)
        second = None
        if sphere is not None and settings.ball_bar_m is not None:
            second = draw_second_sphere(streams.ball_bar, sphere, settings.ball_bar_m)
        scene = Scene(walls, blocks, sphere, second)
        if _fits(scene) and _is_good(scene, camera, projector, settings, first=True):
            return scene
    return None


def _fits(scene: Scene) -> bool:
    solids: list[Block | Ball] = [*scene.blocks]
    solids += scene.spheres.values()
    stacked = (0, 1)  # the second box stands on the first
    return all(_inside(scene.room, sphere) for sphere in scene.spheres.values()) and not any(
        overlap(solids[i], solids[j])
        for i, j in combinations(range(len(solids)), 2)
        if scene.sphere is None or (i, j) != stacked
    )


def _inside(room: Block, sphere: Ball) -> bool:
    """Whether a sphere is inside the walls. A sphere that touches the floor is inside."""
    reach = _TOUCHING * sphere.radius * np.concatenate([np.eye(3), -np.eye(3)])
    return bool(room.contains((sphere.centre + reach).T).all())


def _is_good(
    scene: Scene, camera: PlacedDevice, projector: PlacedDevice, settings: SimulatedRigSettings, *, first: bool
) -> bool:
    """Whether the corner is well visible, and in the first pose the furniture and the whole sphere as well."""
    if not scene.is_free(np.stack([camera.centre, projector.centre], axis=1)).all():
        return False
    view = look(scene, camera, projector)
    if not view.is_suitable(_FURNISHED_FACE) or view.vertex_hidden != settings.hide_vertex:
        return False
    if not (first and settings.furniture):
        return True
    return view.label_shares[Label.FURNITURE] >= 0.04 and view.label_shares[Label.SPHERE] > 0 and view.sphere_lit > 0.8


def _draw_poses(scene: Scene, rig: RigGeometry, first: Place, settings: SimulatedRigSettings) -> list[Place]:
    """The poses of the rig up to the last one in use, beginning with the `first`."""
    rng = _Streams(settings.seed).poses
    places, last = [first], max(settings.pose, settings.projector_pose or 0)
    for _ in range(_ATTEMPTS):
        if len(places) > last:
            return places
        camera, projector = rig.placed(*draw_camera_pose(rng))
        aside = min(float(np.linalg.norm(camera.centre - earlier.centre)) for earlier, _ in places)
        if aside > _POSE_SPACING_M and _is_good(scene, camera, projector, settings, first=False):
            places.append((camera, projector))
    raise DeviceError(
        f"the simulated room of seed {settings.seed} has {len(places)} good places for the rig, which pose "
        f"{last} is beyond; use a smaller pose or another seed"
    )


def _devices(places: Sequence[Place], settings: SimulatedRigSettings) -> Place:
    """Camera and projector. As devices of a network they have separate poses and lenses."""
    if settings.projector_pose is None:
        return places[settings.pose]
    (camera, _), (_, projector) = places[settings.pose], places[settings.projector_pose]
    return zoomed(camera, settings.pose), zoomed(projector, settings.projector_pose)


def draw_walls(rng: np.random.Generator, walls_off_deg: float) -> Block:
    """A closed room whose corner at the origin has three angles of 90° ± `walls_off_deg`; its floor is level."""
    off = np.sin(np.radians(walls_off_deg * rng.standard_normal(3)))
    # Normals of walls at an angle of 90° + δ have the scalar product sin δ. In the order floor, WALL_X, WALL_Y and with
    # the axes z, x, y, the rows of the Cholesky factor are these normals, that of the floor along z.
    gram = np.eye(3) + np.array([[0, off[0], off[1]], [off[0], 0, off[2]], [off[1], off[2], 0]])
    floor, wall_x, wall_y = np.linalg.cholesky(gram)[:, [1, 2, 0]]
    normals = np.stack([wall_x, wall_y, floor])
    legs = np.linalg.inv(normals).T
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    return Block(np.zeros(3), legs * rng.uniform((3.8, 3.8, 2.4), (5.2, 5.2, 2.9))[:, None])
