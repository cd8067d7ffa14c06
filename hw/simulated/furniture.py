"""Furniture of a room: boxes, a cupboard against a wall, a sphere, and optionally a box in the corner."""

import numpy as np

from calib.numerics import Floats
from hw.simulated.shapes import Ball, Block

# Furniture overlaps the floor, the wall or the box below by this much, so that no light passes through a gap.
EMBEDDED_M = 0.004


def draw_furniture(rng: np.random.Generator, sphere_radius_m: float, askew: float) -> tuple[tuple[Block, ...], Ball]:
    """Three cardboard boxes with any heading, two of them stacked; a cupboard; a sphere on the floor.

    `askew`: the angle in radians between the cupboard and its wall.
    """
    large = _standing(rng, rng.uniform((0.25, 0.25, 0.15), (0.45, 0.4, 0.4)), _place(rng, 0.45, 1.1))
    stacked = _on_top(rng, large, rng.uniform((0.12, 0.12, 0.08), (0.2, 0.2, 0.2)))
    second = _standing(rng, rng.uniform((0.15, 0.15, 0.1), (0.35, 0.35, 0.5)), _place(rng, 0.35, 1.2))
    cupboard = _against_wall(rng, rng.uniform((0.6, 0.3, 0.7), (1.2, 0.45, 1.9)), rng.uniform(0.7, 1.4), askew)
    x, y = _place(rng, 0.3, 0.9)
    sphere = Ball(np.array([x, y, sphere_radius_m]), sphere_radius_m)
    return (large, stacked, second, cupboard), sphere


def draw_second_sphere(rng: np.random.Generator, sphere: Ball, length_m: float) -> Ball:
    """The second sphere of a ball bar. `length_m` is between centres; the bar is level or raised, in any direction."""
    azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.8)
    level = np.sqrt(1 - height**2)
    direction = np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])
    return Ball(sphere.centre + length_m * direction, sphere.radius)


def draw_corner_box(rng: np.random.Generator) -> Block:
    """A box pushed into the corner, almost square to the walls."""
    size = rng.uniform((0.15, 0.15, 0.15), (0.3, 0.3, 0.3))
    heading = rng.uniform(-0.15, 0.15)
    reach = 0.5 * (abs(np.cos(heading)) + abs(np.sin(heading))) * size[:2].max()
    return box(size, reach + rng.uniform(0.005, 0.03, 2), heading)


def overlap(first: Block | Ball, second: Block | Ball) -> bool:
    """Whether two solids intersect, tested at the points of a lattice in either."""
    return bool(first.contains(_lattice(second)).any() or second.contains(_lattice(first)).any())


def _place(rng: np.random.Generator, low: float, high: float) -> Floats:
    return rng.uniform(low, high, 2)


def _standing(rng: np.random.Generator, size: Floats, place: Floats) -> Block:
    return box(size, place, rng.uniform(0, np.pi))


def _on_top(rng: np.random.Generator, below: Block, size: Floats) -> Block:
    top = below.origin + below.edges.sum(axis=0)
    middle = below.origin + 0.5 * below.edges.sum(axis=0)
    return box(size, middle[:2] + rng.uniform(-0.05, 0.05, 2), rng.uniform(0, np.pi), float(top[2]))


def _against_wall(rng: np.random.Generator, size: Floats, start: float, askew: float) -> Block:
    """A cupboard that touches one of the two walls with its back or an edge, `start` metres from the corner."""
    width, depth, height = size
    away = (width * abs(np.sin(askew)) + depth * np.cos(askew)) / 2 - EMBEDDED_M
    if rng.random() < 0.5:
        return box(np.array([width, depth, height]), np.array([start + width / 2, away]), askew)
    return box(np.array([depth, width, height]), np.array([away, start + width / 2]), askew)


def box(size: Floats, place: Floats, heading: float, floor: float = 0.0) -> Block:
    """A box of `size` (along, across, up) whose base is centred at `place` (2,), rotated by `heading` radians."""
    cosine, sine = np.cos(heading), np.sin(heading)
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    edges = turned * (size + np.array([0.0, 0.0, EMBEDDED_M]))[:, None]
    origin = np.array([*place, floor - EMBEDDED_M]) - 0.5 * (edges[0] + edges[1])
    return Block(origin, edges)


def _lattice(solid: Block | Ball) -> Floats:
    steps = np.linspace(0.0, 1.0, 9)
    unit = np.stack(np.meshgrid(steps, steps, steps)).reshape(3, -1)
    if isinstance(solid, Block):
        return solid.origin[:, None] + solid.edges.T @ unit
    cube = 2 * unit - 1
    ball: Floats = cube / np.maximum(np.linalg.norm(cube, axis=0), 1.0)
    return solid.centre[:, None] + solid.radius * ball
