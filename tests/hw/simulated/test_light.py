"""Light in cases with known solutions: a room of constant albedo, formulas for plates, conservation of energy."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.numerics import Floats
from hw.settings import SimulatedRigSettings
from hw.simulated.device import Optics, PlacedDevice
from hw.simulated.illumination import ProjectorLight
from hw.simulated.interreflection import Gathered, Gatherer, Interreflection, solve
from hw.simulated.mesh import RadiosityMesh, build_mesh
from hw.simulated.picture import PictureOptics
from hw.simulated.placement import resized
from hw.simulated.room import draw_room
from hw.simulated.scene import Scene
from hw.simulated.shapes import Block
from hw.simulated.texture import Texture, paint

pytestmark = pytest.mark.xdist_group("simulated_light")

ALBEDO = 0.6
SIZES = np.array([4.0, 4.5, 2.6])


@dataclass(frozen=True)
class EmptyRoom:
    light: ProjectorLight
    gatherer: Gatherer
    gathered: Gathered
    interreflection: Interreflection

    @property
    def mesh(self) -> RadiosityMesh:
        return self.gatherer.mesh

    def areas(self) -> Floats:
        """The area of each solving node in m²."""
        support = np.concatenate([chart.support() for chart in self.mesh.solving])
        return np.prod(support[:, 1] - support[:, 0], axis=1)

    def nearest_node(self, surface: int, u: float, v: float) -> tuple[int, float, float]:
        chart = self.mesh.solving[surface]
        column, row = np.abs(chart.u - u).argmin(), np.abs(chart.v - v).argmin()
        return int(chart.start + row * chart.u.size + column), float(chart.u[column]), float(chart.v[row])


@pytest.fixture(scope="module")
def empty() -> EmptyRoom:
    drawn = draw_room(SimulatedRigSettings(seed=1, furniture=False))
    scene = Scene(Block(np.zeros(3), np.diag(SIZES)))
    light = ProjectorLight(scene, replace(drawn.projector, optics=resized(drawn.projector.optics, 427, 240)))
    texture = paint(scene, np.random.default_rng(0), None)
    even = Texture(scene, np.full_like(texture.texels, ALBEDO), texture.start, texture.shape, texture.texel_m)
    optics = light.projector.optics
    picture = PictureOptics(optics.width, optics.height, gamma=2.2, contrast=1000.0, blur_px=0.5)
    gatherer = Gatherer(light, even, picture, build_mesh(light))
    gathered = gatherer.gather(384, np.random.default_rng(1))
    return EmptyRoom(light, gatherer, gathered, solve(scene, gatherer.mesh, gathered))


def test_every_node_of_an_empty_room_receives_light_only_from_the_room(empty: EmptyRoom) -> None:
    assert empty.gathered.exposed.all()
    np.testing.assert_allclose(empty.gathered.from_nodes.sum(axis=1), ALBEDO, rtol=1e-4)


def rectangle_overhead(a: float, b: float, c: float) -> float:
    """Form factor from a small area to a parallel rectangle a × b at distance c, with one corner straight above.

    Siegel and Howell, Thermal Radiation Heat Transfer, appendix of configuration factors, as for the next one.
    """
    x, y = a / c, b / c
    p, q = np.hypot(1, x), np.hypot(1, y)
    return float((x / p * np.arctan(y / p) + y / q * np.arctan(x / q)) / (2 * np.pi))


def rectangle_aside(a: float, b: float, c: float) -> float:
    """Form factor from a small area to a perpendicular rectangle that starts at distance c beside it and extends a
    forward and b along.
    """
    x, y = a / b, c / b
    s = np.hypot(x, y)
    return float((np.arctan(1 / y) - y / s * np.arctan(1 / s)) / (2 * np.pi))


@pytest.mark.parametrize("place", [(0.5, 0.5), (2.0, 2.0), (3.3, 1.0), (0.1, 4.0)])
def test_form_factors_from_floor_to_ceiling(empty: EmptyRoom, place: tuple[float, float]) -> None:
    node, x, y = empty.nearest_node(2, *place)
    (length, width, height) = SIZES
    expected = sum(rectangle_overhead(a, b, height) for a in (x, length - x) for b in (y, width - y))
    error = abs(empty.gathered.from_ceiling[node] - expected)
    assert 1e-5 < error < 0.015


@pytest.mark.parametrize("place", [(0.5, 0.5), (2.0, 1.3), (2.0, 2.3), (4.0, 1.0)])
def test_form_factors_from_a_wall_to_the_ceiling(empty: EmptyRoom, place: tuple[float, float]) -> None:
    node, y, z = empty.nearest_node(0, *place)  # on x = 0, seeing a ceiling that begins there at the height 2.6
    distance = SIZES[2] - z
    expected = sum(rectangle_aside(SIZES[0], b, distance) for b in (y, SIZES[1] - y))
    error = abs(empty.gathered.from_ceiling[node] - expected)
    assert 1e-5 < error < 0.015


def test_reflections_conserve_energy(empty: EmptyRoom) -> None:
    """The light of a ceiling of radiosity 1 falls on the walls 1 / (1 − albedo) times."""
    count = empty.mesh.solving_count
    incident = float(empty.areas() @ empty.interreflection.ceiling[:count])
    emitted = SIZES[0] * SIZES[1]
    assert incident == pytest.approx(emitted / (1 - ALBEDO), rel=0.02)


def test_indirect_light_of_a_picture_is_the_reflected_direct_light(empty: EmptyRoom) -> None:
    """The total indirect light is the direct flux times albedo / (1 − albedo)."""
    optics = empty.light.projector.optics
    x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
    rays = optics.to_rays(np.stack([x.ravel(), y.ravel()]).astype(float))
    # Each pixel's share of the plane z = 1, of a lens with little distortion, and the documented vignetting of 25 %.
    brightness = optics.vignetting(np.stack([x.ravel(), y.ravel()]).astype(float), 0.25)
    plane = rays[:2].reshape(2, optics.height, optics.width)
    areas = np.gradient(plane[0], axis=1) * np.gradient(plane[1], axis=0)
    flux = float(areas.ravel() @ brightness)

    pyramid = empty.gatherer.picture.pyramid(np.ones((optics.height, optics.width), np.float32))
    count = empty.mesh.solving_count
    indirect = float(empty.areas() @ empty.interreflection.irradiance(pyramid)[:count])
    assert indirect == pytest.approx(flux * ALBEDO / (1 - ALBEDO), rel=0.02)


def irradiance_on_axis(distance: float, turn: float) -> float:
    """Irradiance on a wall at a distance, by a projector rotated from its normal by an angle in radians."""
    wall = Scene(Block(np.array([0.0, -50.0, -50.0]), np.diag([distance, 100.0, 100.0])))
    forward, right = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([np.sin(turn), -np.cos(turn), 0.0])
    rotation = np.stack([right, [0.0, 0.0, -1.0], forward])
    projector = PlacedDevice(Optics(854, 480, 1247.3, (377.1, 234.0)), rotation, np.zeros(3))
    spot = np.array([[distance], [distance * np.tan(turn)], [0.0]])
    pixel, irradiance = ProjectorLight(wall, projector).direct(np.array([3], np.int32), spot)
    np.testing.assert_allclose(pixel[:, 0], [377.1, 234.0], atol=1e-9)
    return float(irradiance[0])


@pytest.mark.parametrize("distance", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2])
def test_direct_light_falls_with_the_square_of_distance_and_the_cosine(distance: float, turn: float) -> None:
    along_axis = distance / np.cos(turn)
    assert irradiance_on_axis(distance, turn) == pytest.approx(np.cos(turn) / along_axis**2)


def test_every_face_has_fine_strips_along_both_of_its_creases(empty: EmptyRoom) -> None:
    """Six centimetres wide, along all of the light; together they cover no place twice."""
    for face in range(3):
        wide, tall = (
            next(chart for chart in empty.mesh.creases if chart.surface == face and is_tall == (np.ptp(chart.v) > 0.1))
            for is_tall in (False, True)
        )
        assert sum(chart.surface == face for chart in empty.mesh.creases) == 2
        assert (tall.u[0], tall.u[-1], tall.v[0]) == (0.0, 0.06, 0.0)
        assert (wide.v[0], wide.v[-1], wide.u[0]) == (0.0, 0.06, 0.06)
        assert 0.5 < tall.v[-1] <= SIZES[(face + 2) % 3]
        assert 0.5 < wide.u[-1] <= SIZES[(face + 1) % 3]
        for along in (tall.v, wide.u):
            assert 0.002 < np.diff(along).min() <= np.diff(along).max() < 0.2


def test_indirect_fringes_survive_near_a_crease_and_cancel_farther_away(empty: EmptyRoom) -> None:
    """Light of the other face keeps fringes of 16 pixels within a centimetre, and loses them beyond ten."""
    optics = empty.light.projector.optics
    picture = empty.gatherer.picture
    fringe = 0.5 + 0.5 * np.cos(2 * np.pi * np.arange(optics.width) / 16)
    image = np.tile(fringe.astype(np.float32), (optics.height, 1))
    solution = empty.interreflection
    white = solution.irradiance(picture.pyramid(np.ones_like(image)))
    swing = 2 * solution.irradiance(picture.pyramid(image)) - white
    relative = np.abs(swing) / np.maximum(white, 1e-9)
    chart = next(c for c in empty.mesh.creases if c.surface == 2 and c.u.size < c.v.size)
    grid = relative[chart.start : chart.start + chart.count].reshape(chart.v.size, chart.u.size)
    lit = slice(5, chart.v.size - 15)
    contrast = np.sqrt(np.mean(grid[lit] ** 2, axis=0))  # by distance from the crease
    assert 0.05 < contrast[0] < 0.8
    assert 1e-4 < contrast[-1] < 0.2 * contrast[0]
