"""A smooth asymmetric body whose surface is known in closed form: clouds of parts of it, and its mesh."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from calib.numerics import Floats, Ints


@dataclass(frozen=True)
class Blob:
    """Radius in a direction: an ellipsoid with waves. Lengths in mm, about 100 mm across."""

    axes: tuple[float, float, float] = (50.0, 42.0, 33.0)
    waves: float = 4.0
    dent: float = 0.0
    """Depth of a Gaussian dent about the direction z."""

    def points(self, ways: Floats) -> Floats:
        """Surface points (N, 3) in unit directions (N, 3)."""
        radius = 1 / np.linalg.norm(ways / np.array(self.axes), axis=1)
        x, y, z = ways.T
        radius += self.waves * (
            np.sin(5 * x + 1) * np.cos(4 * y) + np.sin(6 * z + 2 * x) * 0.7 + 0.5 * np.cos(7 * y - z)
        )
        apart = np.linalg.norm(ways - [0.0, 0.0, 1.0], axis=1)
        radius -= self.dent * np.exp(-((apart / 0.15) ** 2))
        points: Floats = radius[:, None] * ways
        return points

    def normals(self, ways: Floats) -> Floats:
        """Outward normals (N, 3) in those directions, by differences."""
        step = 1e-5
        aside = np.cross(ways, np.where(np.abs(ways[:, :1]) < 0.8, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        over = np.cross(ways, aside)
        tangents = []
        for way in (aside, over):
            ahead, behind = ways + step * way, ways - step * way
            ends = [self.points(each / np.linalg.norm(each, axis=1, keepdims=True)) for each in (ahead, behind)]
            tangents.append(ends[0] - ends[1])
        normals = np.cross(tangents[0], tangents[1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        out: Floats = normals * np.sign(np.sum(normals * ways, axis=1))[:, None]
        return out

    def cloud(
        self, count: int, seed: int, towards: tuple[float, float, float] | None = None, noise: float = 0.02
    ) -> tuple[Floats, Floats]:
        """Points and normals (N, 3) of what faces a direction, of `count` points all around."""
        rng = np.random.default_rng(seed)
        ways = rng.standard_normal((count, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        normals = self.normals(ways)
        if towards is not None:
            seen = normals @ np.array(towards) / np.linalg.norm(towards) > 0.25
            ways, normals = ways[seen], normals[seen]
        points: Floats = self.points(ways) + noise * rng.standard_normal((len(ways), 1)) * normals
        return points, normals

    def mesh(self, count: int = 20_000) -> tuple[Floats, Ints]:
        """Vertices (V, 3) and outward triangles (T, 3)."""
        k = np.arange(count) + 0.5
        inclination, azimuth = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
        ways = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1) * np.sin(inclination)[:, None]
        ways[:, 2] = np.cos(inclination)
        triangles = ConvexHull(ways).simplices.astype(np.int64)
        a, b, c = (ways[triangles[:, i]] for i in range(3))
        inward = np.sum(np.cross(b - a, c - a) * a, axis=1) < 0
        triangles[inward] = triangles[inward][:, ::-1]
        return self.points(ways), triangles
