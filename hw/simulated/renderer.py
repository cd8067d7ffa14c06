"""The camera's view of a room for any picture: direct light, indirect light, ambient light."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from calib.numerics import Floats, Image
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light
from hw.simulated.board import draw_board
from hw.simulated.device import PlacedDevice
from hw.simulated.footprints import FootprintCaster, Footprints, samples_per_pixel
from hw.simulated.illumination import ProjectorLight
from hw.simulated.interreflection import Gatherer, Interreflection, solve
from hw.simulated.mesh import build_mesh
from hw.simulated.motion import rotation_homography
from hw.simulated.picture import PictureOptics
from hw.simulated.room import DrawnRoom
from hw.simulated.shapes import Block
from hw.simulated.texture import paint

_RAYS_PER_NODE = 384
_FEWER_RAYS_PER_NODE = 128  # for ambient light alone, and for a whole room, which has many more nodes
_WALLPAPER_STREAM = 102  # a stream of its own: a wallpaper leaves all other random numbers unchanged


@dataclass(frozen=True)
class Renderer:
    """The linear map from a picture to the brightness of the camera's pixels, found once for all pictures."""

    picture: PictureOptics
    caster: FootprintCaster
    footprints: Footprints
    """Of all camera pixels, by `caster`."""
    interreflection: Interreflection | None
    """None if surfaces do not light each other."""
    ceiling: Light
    """Irradiance by ambient light as bright as the projector's white, scaled by `ambient_level`, (nodes,)."""
    ambient_level: float
    turn: Floats | None = None
    """Homography from the pixels of a projector that has moved to those with the same direction when the
    interreflection was solved, (3, 3); None if it has not moved.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the camera's image."""
        optics = self.caster.camera.optics
        return optics.height, optics.width

    @cached_property
    def ambient(self) -> Light:
        """Brightness without the projector, (H, W)."""
        return np.float32(self.ambient_level) * self.room_light

    @cached_property
    def room_light(self) -> Light:
        """`ambient` at a level of one, (H, W)."""
        return self._of_nodes(self.ceiling)

    def render(self, picture: Image) -> Light:
        """Brightness of the camera's pixels, (H, W), for an 8-bit projector picture, before the camera's lens."""
        return self.projected(self.picture.linear(picture)) + self.ambient

    def projected(self, light: Light) -> Light:
        """All light from the projector, direct and indirect, (H, W), for linear light (H, W) of its pixels."""
        return self.direct(light) + self.indirect(light)

    def direct(self, light: Light) -> Light:
        """Direct light of the projector, (H, W), for linear light (H, W) of its pixels."""
        return (self.footprints.direct @ self.picture.blurred(light)).reshape(self.shape)

    def indirect(self, light: Light) -> Light:
        """Light of the projector that was reflected at least once before it reached the visible surface, (H, W)."""
        if self.interreflection is None:
            return np.zeros(self.shape, np.float32)
        if self.turn is not None:
            light = np.asarray(cv2.warpPerspective(light, self.turn, light.shape[::-1]), np.float32)
        return self._of_nodes(self.interreflection.irradiance(self.picture.pyramid(light)))

    def moved(self, camera: PlacedDevice, projector: PlacedDevice, *blocks: Block) -> "Renderer":
        """The view after the devices have rotated slightly; only rays are cast again.

        A projector that rotates about its lens lights the room like one at rest that shows its picture rotated. Moving
        `blocks` occlude and cast shadows, but the exchange of light between surfaces is computed without them.
        """
        caster = self.caster.moved(camera, projector, *blocks)
        turn = rotation_homography(self.caster.light.projector, projector)
        return replace(self, caster=caster, footprints=caster.cast(), turn=turn)

    def with_board(self, settings: SimulatedRigSettings) -> "Renderer":
        """The view with the board of these settings, or none, in front of the room; only its rays are cast."""
        camera, projector = self.caster.camera, self.caster.light.projector
        board = None
        if settings.board.square_m:
            board = draw_board(settings.board, settings.seed, camera, projector, self.caster.light.scene)
        caster = replace(self.caster, board=board)
        bare = self.footprints if self.caster.board is None else None
        return replace(self, caster=caster, footprints=caster.cast(bare))

    def _of_nodes(self, irradiance: Light) -> Light:
        return (self.footprints.indirect @ irradiance).reshape(self.shape)


def has_indirect_light(settings: SimulatedRigSettings) -> bool:
    """Whether surfaces light each other, or ambient light does at any time: otherwise no exchange has to be solved."""
    return settings.interreflection or max(settings.ambient, settings.light.ambient or 0.0) > 0


def build_renderer(room: DrawnRoom, settings: SimulatedRigSettings, rng: np.random.Generator) -> Renderer:
    """Paint the room, solve the interreflection of its surfaces, and cast the rays of all camera pixels."""
    projector = room.projector.optics
    picture = PictureOptics(
        projector.width, projector.height, settings.gamma, settings.contrast, settings.projector_blur_px
    ).under(settings)
    light = ProjectorLight(room.scene, room.projector)
    wallpaper = np.random.default_rng([settings.seed, _WALLPAPER_STREAM]) if settings.wallpaper else None
    texture = paint(room.scene, rng, settings.albedo, wallpaper)
    mesh = build_mesh(light)
    fewer = room.scene.all_round or not settings.interreflection
    solved = None
    if has_indirect_light(settings):
        gathered = Gatherer(light, texture, picture, mesh).gather(
            _FEWER_RAYS_PER_NODE if fewer else _RAYS_PER_NODE, rng
        )
        solved = solve(room.scene, mesh, gathered)
    samples = samples_per_pixel(room.camera, room.projector)
    stand_in = np.arange(mesh.count) if solved is None else solved.stand_in
    caster = FootprintCaster(light, room.camera, texture, picture, mesh, stand_in, samples)
    ceiling = np.zeros(mesh.count, np.float32) if solved is None else solved.ceiling
    renderer = Renderer(
        picture, caster, caster.cast(), solved if settings.interreflection else None, ceiling, ambient_level=1.0
    )
    if solved is not None:
        renderer = replace(renderer, ceiling=ceiling * _white_over_ambient(renderer))
    renderer = replace(renderer, ambient_level=settings.ambient)
    return renderer.with_board(settings) if settings.board.square_m else renderer


def _white_over_ambient(renderer: Renderer) -> np.float32:
    """Ratio of the projector's white to the ambient light where the projector lights the room."""
    white = renderer.direct(np.ones((renderer.picture.height, renderer.picture.width), np.float32))
    lit = white > 0
    return np.float32(np.median(white[lit]) / np.median(renderer.ambient[lit]))
