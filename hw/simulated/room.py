"""A room, drawn from a seed: walls, furniture, and a rig in a place that a sensible operator would choose."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.furniture import draw_corner_box, draw_furniture, draw_other_end, overlap
from hw.simulated.placement import RigGeometry, draw_camera_pose, draw_rig, zoomed
from hw.simulated.scene import Label, Scene
from hw.simulated.shapes import Block, Sphere
from hw.simulated.view import look
from hw.simulated.whole_room import draw_whole_room

_ATTEMPTS = 3000
_FURNITURE_ATTEMPTS = 300
# The smallest share of the lit pixels that a face of the corner may have, without and with furniture before it.
_BARE_FACE = 0.22
_FURNISHED_FACE = 0.15
_TOUCHING = 0.98  # of a radius
_STEP_ASIDE_M = 0.35  # poses are at least this far apart


@dataclass(frozen=True)
class Room:
    """A scene and the two devices in it."""

    scene: Scene
    camera: PlacedDevice
    projector: PlacedDevice


class _Streams:
    """Independent random numbers for each thing that is drawn, so that a setting of one leaves the others alone."""

    def __init__(self, seed: int) -> None:
        self.walls, self.rig, self.furniture, self.corner_box, self.poses, self.askew, self.ball_bar = (
            np.random.default_rng([seed, stream]) for stream in range(7)
        )


def draw_room(settings: SimulatedRigSettings) -> Room:
    """Draw again until the view is one that an operator's guide would recommend (`View.is_sensible`).

    The devices have the paper's resolution. Raises DeviceError if the seed has no such view or too few for the pose.
    """
    streams = _Streams(settings.seed)
    walls = draw_walls(streams.walls, settings.walls_off_deg)
    if settings.room == "whole":
        whole = draw_whole_room(settings, walls)
        return Room(whole.scene, *_devices(whole.stations, settings))
    for _ in range(_ATTEMPTS):
        rig = draw_rig(streams.rig, settings.distortion)
        camera, projector = rig.placed(*draw_camera_pose(streams.rig))
        if not look(Scene(walls), camera, projector).is_sensible(_BARE_FACE):
            continue
        scene = _furnish(walls, camera, projector, settings, streams)
        if scene is not None:
            places = _step_aside(scene, rig, camera, projector, settings, streams.poses)
            return Room(scene, *_devices(places, settings))
    raise DeviceError(
        f"the simulated rig finds no good view of the corner in its room; use another seed than {settings.seed}"
    )


def _furnish(
    walls: Block, camera: PlacedDevice, projector: PlacedDevice, settings: SimulatedRigSettings, streams: _Streams
) -> Scene | None:
    """The room with furniture that leaves enough of the corner to see, or None if none was found."""
    for _ in range(_FURNITURE_ATTEMPTS):
        blocks: tuple[Block, ...] = ()
        sphere: Sphere | None = None
        if settings.furniture:
            askew = np.radians(settings.furniture_askew_deg * streams.askew.standard_normal())
            blocks, sphere = draw_furniture(streams.furniture, settings.sphere_radius_m, askew)
        if settings.hide_vertex:
            blocks += (draw_corner_box(streams.corner_box),)
        second = None
        if sphere is not None and settings.ball_bar_m is not None:
            second = draw_other_end(streams.ball_bar, sphere, settings.ball_bar_m)
        scene = Scene(walls, blocks, sphere, second)
        if _fits(scene) and _is_good(scene, camera, projector, settings, first=True):
            return scene
    return None


def _fits(scene: Scene) -> bool:
    solids: list[Block | Sphere] = [*scene.blocks]
    solids += scene.spheres.values()
    stacked = (0, 1)  # the first box carries the second
    return all(_inside(scene.room, sphere) for sphere in scene.spheres.values()) and not any(
        overlap(solids[i], solids[j])
        for i, j in combinations(range(len(solids)), 2)
        if scene.sphere is None or (i, j) != stacked
    )


def _inside(room: Block, sphere: Sphere) -> bool:
    """Whether a sphere is within the walls; that it stands on the floor is no overlap."""
    reach = _TOUCHING * sphere.radius * np.concatenate([np.eye(3), -np.eye(3)])
    return bool(room.contains((sphere.centre + reach).T).all())


def _is_good(
    scene: Scene, camera: PlacedDevice, projector: PlacedDevice, settings: SimulatedRigSettings, *, first: bool
) -> bool:
    """The corner is well seen; from the rig's first place the furniture and the whole sphere are seen as well."""
    if not scene.is_free(np.stack([camera.centre, projector.centre], axis=1)).all():
        return False
    view = look(scene, camera, projector)
    if not view.is_sensible(_FURNISHED_FACE) or view.vertex_hidden != settings.hide_vertex:
        return False
    if not (first and settings.furniture):
        return True
    return view.label_shares[Label.FURNITURE] >= 0.04 and view.label_shares[Label.SPHERE] > 0 and view.sphere_lit > 0.8


def _step_aside(
    scene: Scene,
    rig: RigGeometry,
    camera: PlacedDevice,
    projector: PlacedDevice,
    settings: SimulatedRigSettings,
    rng: np.random.Generator,
) -> list[tuple[PlacedDevice, PlacedDevice]]:
    """The rig's places up to the last that is asked for; number 0 is where it is given."""
    places, last = [(camera, projector)], max(settings.pose, settings.projector_pose or 0)
    for _ in range(_ATTEMPTS):
        if len(places) > last:
            return places
        camera, projector = rig.placed(*draw_camera_pose(rng))
        aside = min(float(np.linalg.norm(camera.centre - other.centre)) for other, _ in places)
        if aside > _STEP_ASIDE_M and _is_good(scene, camera, projector, settings, first=False):
            places.append((camera, projector))
    raise DeviceError(
        f"the simulated room of seed {settings.seed} has {len(places)} good places for the rig, which pose "
        f"{last} is beyond; use a smaller pose or another seed"
    )


def _devices(
    places: Sequence[tuple[PlacedDevice, PlacedDevice]], settings: SimulatedRigSettings
) -> tuple[PlacedDevice, PlacedDevice]:
    """Camera and projector, which as devices of a network are at places, and have lenses, of their own."""
    if settings.projector_pose is None:
        return places[settings.pose]
    (camera, _), (_, projector) = places[settings.pose], places[settings.projector_pose]
    return zoomed(camera, settings.pose), zoomed(projector, settings.projector_pose)


def draw_walls(rng: np.random.Generator, walls_off_deg: float) -> Block:
    """A closed room whose corner at the origin has three angles of 90° ± `walls_off_deg`; its floor is level."""
    off = np.sin(np.radians(walls_off_deg * rng.standard_normal(3)))
    # Between walls at an angle of 90° + δ the normals into the room have the cosine sin δ. In the order floor,
    # WALL_X, WALL_Y and with the axes z, x, y, Cholesky's factor has these normals as rows, the floor's along z.
    gram = np.eye(3) + np.array([[0, off[0], off[1]], [off[0], 0, off[2]], [off[1], off[2], 0]])
    floor, wall_x, wall_y = np.linalg.cholesky(gram)[:, [1, 2, 0]]
    normals = np.stack([wall_x, wall_y, floor])
    legs = np.linalg.inv(normals).T
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    return Block(np.zeros(3), legs * rng.uniform((3.8, 3.8, 2.4), (5.2, 5.2, 2.9))[:, None])
