"""Comparison of scans of things with their CAD models: dents that are there are found and measured, and no others.

    python benchmarks/bench_compare.py [--things 4] [--first 0] [--dent 0.2] [--points 60000]

Simulated things of 100 mm, as of bench_register.py, seen from one side with 0.03 mm of noise along the ray, placed
anywhere, and compared with their mesh as STL. Each is scanned sound, and with a dent of 6 mm radius (1/e) on the side
that is seen. 'deviation': of the region at the dent, less its true depth; 'sigma': what was told. 'false': regions
elsewhere, or on the sound thing. z: robust standard deviation of the sound thing's deviations over their sigmas. Files
are real: they are written and read again.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from calib.deferred_imports import open3d
from calib.numerics import Floats, robust_sigma
from scanner.comparing import SurfaceComparison, compare_surfaces

sys.path.append(str(Path(__file__).parent))
from bench_register import lump, random_pose, seen, towards

_RADIUS = 0.006  # m
_NEAR = 5.0  # mm


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--things", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--dent", type=float, default=0.2, help="depth in mm")
    parser.add_argument("--points", type=int, default=60_000)
    args = parser.parse_args()
    print("thing  found  deviation off, mm  sigma, mm  false, dented  false, sound     z  seconds")
    found = false = 0
    for seed in range(args.first, args.first + args.things):
        dented, at, seconds = compared(seed, args.dent, args.points)
        sound, _, _ = compared(seed, 0.0, args.points)
        near = [region for region in dented.regions if np.linalg.norm(region.centre - at) < _NEAR]
        others, alone = len(dented.regions) - len(near), len(sound.regions)
        found += bool(near)
        false += others + alone
        off, sigma = (near[0].peak + args.dent, near[0].sigma) if near else (np.nan, np.nan)
        assert sound.measured is not None
        there = sound.measured.there
        z = robust_sigma(sound.compared / sound.measured.sigma[there])
        print(
            f"{seed:5}  {bool(near)!s:5}  {off:17.3f}  {sigma:9.3f}  {others:13}  {alone:12}  {z:4.2f}  {seconds:7.1f}"
        )
    print(f"{found} of {args.things} found, {false} false")


def compared(seed: int, dent: float, points: int) -> tuple[SurfaceComparison, Floats, float]:
    """The comparison, where the dent is, and the time that it took."""
    o3d, rng = open3d(), np.random.default_rng([seed, 21])
    vertices, triangles = lump(seed)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(1000 * vertices), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    normals = np.asarray(mesh.compute_vertex_normals().vertex_normals)
    way = towards(rng)
    deepest = int(np.argmax(normals @ way))
    apart = np.linalg.norm(vertices - vertices[deepest], axis=1)
    changed = vertices - 1e-3 * dent * np.exp(-((apart / _RADIUS) ** 2))[:, None] * normals
    scan = seen((changed, triangles), way, points, np.random.default_rng([seed, 22]))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(1000 * (random_pose(rng, 0.3) @ scan.points)))
    with tempfile.TemporaryDirectory() as folder:
        part, model = Path(folder) / "part.xyz", Path(folder) / "cad.stl"
        o3d.io.write_point_cloud(str(part), cloud)
        o3d.io.write_triangle_mesh(str(model), mesh)
        start = time.perf_counter()
        comparison = compare_surfaces(part, model, unit="mm")
        seconds = time.perf_counter() - start
    return comparison, 1000 * vertices[deepest], seconds


if __name__ == "__main__":
    main()
