"""Planes: distances, motions, the plane through points, and steps of estimators."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.pose import Pose, tangent_basis
from calib.numerics import Floats

PER_PLANE = 3  # numbers of a step: two tilts, along `tangent_basis` of the normal, and the offset


@dataclass(frozen=True, eq=False)
class Plane:
    """The points X with `normal` · X = `offset`."""

    normal: Floats
    """(3,), of unit length, towards the side from which the plane is seen."""
    offset: float
    """Distance from the origin along the normal: negative if the origin is on the seen side."""

    @classmethod
    def through(cls, points: Floats, weight: Floats, seen_from: Floats | None = None) -> "Plane":
        """Least squares through points (N, 3) of `weight` (N,); `seen_from` (3,): a point on the side of its normal, by
        default the origin.
        """
        centre = np.average(points, axis=0, weights=weight)
        from_centre = points - centre
        normal = np.linalg.eigh((weight[:, None] * from_centre).T @ from_centre)[1][:, 0]
        towards = -centre if seen_from is None else seen_from - centre
        if normal @ towards < 0:
            normal = -normal
        return cls(normal, float(normal @ centre))

    def heights(self, points: Floats) -> Floats:
        """Signed distances of points (..., 3) from the plane, positive on the side of the normal."""
        return points @ self.normal - self.offset

    def offset_from(self, origin: Floats) -> float:
        """The plane's offset with another origin (3,)."""
        return self.offset - float(self.normal @ origin)

    def depths(self, directions: Floats, origin: Floats) -> Floats:
        """Multiples (N,) of directions (N, 3) after which rays from `origin` (3,) meet the plane."""
        return self.offset_from(origin) / (directions @ self.normal)

    def moved(self, motion: Pose, factor: float = 1.0) -> "Plane":
        """The plane after X → factor · (motion @ X)."""
        normal: Floats = motion.rotation @ self.normal
        return Plane(normal, factor * (self.offset + float(normal @ motion.translation)))

    def retract(self, step: Floats) -> "Plane":
        """The plane after a step (3,): two tilts along `tangent_basis` of its normal, and its offset."""
        tilted = self.normal + tangent_basis(self.normal) @ step[:2]
        return Plane(tilted / np.sqrt(tilted @ tilted), self.offset + float(step[2]))

    def local(self, plane: "Plane") -> Floats:
        """The step (3,) from here to a plane that is less than 90° away, of which `retract` is the inverse."""
        tilts = tangent_basis(self.normal).T @ plane.normal / (self.normal @ plane.normal)
        return np.array([*tilts, plane.offset - self.offset])
