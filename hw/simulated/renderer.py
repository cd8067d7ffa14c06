"""The camera's view of a room for any picture: direct light, indirect light, ambient light."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from calib.numerics import Image, in_parallel
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light
from hw.simulated.footprints import FootprintCaster, Footprints, samples_per_pixel
from hw.simulated.gather import Gatherer
from hw.simulated.illumination import ProjectorLight
from hw.simulated.interreflection import Interreflection, solve
from hw.simulated.mesh import build_mesh
from hw.simulated.picture import PictureOptics
from hw.simulated.room import Room
from hw.simulated.texture import paint

_RAYS_PER_NODE = 384
_WALLPAPER_STREAM = 102  # apart from all other random numbers, so that they stay as they are without it
_STRIP_PIXELS = 1 << 14  # small enough for its arrays to stay in cache


@dataclass(frozen=True)
class Renderer:
    """Light is linear in the picture: what the room does to it is found once, a picture then costs a few products.

    `footprints`: of all camera pixels. `interreflection`: None if light is not to be reflected on to other surfaces.
    `ambient` (H, W): brightness without the projector.
    """

    picture: PictureOptics
    footprints: Footprints
    interreflection: Interreflection | None
    ambient: Light

    def render(self, picture: Image) -> Light:
        """Brightness of the camera's pixels, (H, W), for an 8-bit projector picture, before the camera's own lens."""
        light = self.picture.linear(picture)
        return self.direct(light) + self.indirect(light) + self.ambient

    def direct(self, light: Light) -> Light:
        """The part that comes straight from the projector, for linear light (H, W) of its pixels."""
        image: Light = (self.footprints.direct @ self.picture.blurred(light)).reshape(self.ambient.shape)
        return image

    def indirect(self, light: Light) -> Light:
        """The part that was reflected at least once before it reached the surface that the camera sees."""
        if self.interreflection is None:
            return np.zeros(self.ambient.shape, np.float32)
        nodes = self.interreflection.irradiance(self.picture.pyramid(light))
        image: Light = (self.footprints.indirect @ nodes).reshape(self.ambient.shape)
        return image


def build_renderer(room: Room, settings: SimulatedRigSettings, rng: np.random.Generator) -> Renderer:
    """Paint the room, let its surfaces light each other, and find what each camera pixel sees of it."""
    camera, projector = room.camera.optics, room.projector.optics
    picture = PictureOptics(
        projector.width, projector.height, settings.gamma, settings.contrast, settings.projector_blur_px
    )
    light = ProjectorLight(room.scene, room.projector)
    wallpaper = np.random.default_rng([settings.seed, _WALLPAPER_STREAM]) if settings.wallpaper else None
    texture = paint(room.scene, rng, settings.albedo, wallpaper)
    mesh = build_mesh(light)
    gathered = Gatherer(light, texture, picture, mesh).gather(_RAYS_PER_NODE, rng)
    interreflection = solve(room.scene, mesh, gathered)
    samples = samples_per_pixel(room.camera, room.projector)
    caster = FootprintCaster(light, room.camera, texture, picture, mesh, interreflection.stand_in, samples)

    dark = Renderer(
        picture,
        _all_footprints(caster, camera.width, camera.height),
        interreflection if settings.interreflection else None,
        np.zeros((camera.height, camera.width), np.float32),
    )
    return replace(dark, ambient=_ambient(dark, interreflection.ceiling, settings.ambient))


def _all_footprints(caster: FootprintCaster, width: int, height: int) -> Footprints:
    step = max(1, _STRIP_PIXELS // width)
    strips = [range(row, min(row + step, height)) for row in range(0, height, step)]
    parts = in_parallel(caster.strip, strips)
    return Footprints(
        sparse.vstack([part.direct for part in parts], format="csr"),
        sparse.vstack([part.indirect for part in parts], format="csr"),
    )


def _ambient(renderer: Renderer, from_ceiling: Light, level: float) -> Light:
    """Light that the ceiling sends into the room, scaled to `level` times the projector's white where that falls."""
    unit: Light = (renderer.footprints.indirect @ from_ceiling).reshape(renderer.ambient.shape)
    white = renderer.direct(np.ones((renderer.picture.height, renderer.picture.width), np.float32))
    lit = white > 0
    return unit * np.float32(level * np.median(white[lit]) / np.median(unit[lit]))
