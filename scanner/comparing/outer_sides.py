"""Which side of a surface is outside, where its file does not say, or says the contrary of the other one's."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.numerics import Floats
from calib.registration import Alignment, SampledSurface, SurfacePoints, SurfaceRegistration, sample_surface
from scanner.comparing.surfaces import nearest_values

_AGREE = 0.8  # share of the normals on one side of the reference's, beyond which all of them are

Register = Callable[[SurfacePoints, SurfacePoints], SurfaceRegistration]


def register_either_side(
    first: SurfacePoints,
    second: SurfacePoints,
    register: Register,
    known: tuple[bool, bool],
    *,
    is_only_mesh: bool = False,
) -> tuple[SurfaceRegistration, int | None]:
    """The registration of two surfaces, and which of them, 0 or 1, fits only with its normals on the other side.

    Programs compute normals whose sign means nothing, and meshes are inside out. `known`: of which the outer side is
    certain; the other one is turned. If neither is, the first one is, if it `is_only_mesh` of the two;
    otherwise the second one. Raises what `register` does.
    """
    registration = register(first, second)
    given = first.normals is not None and second.normals is not None
    if registration.alignment is not Alignment.NONE or not given or all(known):
        return registration, None
    number = 0 if known[1] or (is_only_mesh and not known[0]) else 1
    sides = [_turned(side) if k == number else side for k, side in enumerate((first, second))]
    again = register(*sides)
    return (registration, None) if again.alignment is Alignment.NONE else (again, number)


def turned_note(name: str, reference: str) -> str:
    """What was done to the normals of a surface, for people."""
    return f"{name}: its normals are on the other side of the surface than those of {reference}, and were turned round."


def _turned(side: SurfacePoints) -> SurfacePoints:
    return replace(side, normals=None if side.normals is None else -side.normals)


def outer_normals(
    points: Floats, cell: float, eye: Floats | None, reference: SampledSurface | None
) -> tuple[Floats, bool]:
    """Normals (N, 3) of points (N, 3) without any, and whether their side is known: that of the scanner's place, or of
    the normals of an aligned reference.

    Raises ValueError for too few points, ImportError where Open3D is missing.
    """
    surface = sample_surface(points, None, cell)
    normals = surface.normals
    if reference is not None and eye is None:
        along = np.sum(nearest_values(reference.points, reference.normals, surface.points) * normals, axis=1)
        share = float(np.mean(along > 0))
        one_side = max(share, 1 - share) > _AGREE
        normals = normals * (np.sign(share - 0.5) if one_side else np.where(along < 0, -1.0, 1.0)[:, None])
    outer = nearest_values(surface.points, normals, points)
    if eye is not None:
        outer = towards(outer, points, eye)
    return outer, eye is not None or reference is not None


def towards(normals: Floats, points: Floats, eye: Floats) -> Floats:
    """Normals (N, 3) of points (N, 3), turned to the side of an eye (3,)."""
    turned: Floats = normals * np.where(np.sum(normals * (eye - points), axis=1) < 0, -1.0, 1.0)[:, None]
    return turned
