"""Registration of two clouds or meshes of any origin without a first guess, compared with the truth.

    python benchmarks/bench_register.py [--pairs 8] [--kinds part cad room …] [--points 200000] [--verbose] [--peers]
    python benchmarks/bench_register.py --pairs 84 --keep rows.jsonl --minutes 20

Simulated things of 100 mm (superquadrics with waves) are seen from two directions, with noise along the ray, other
densities and the shadow of a projector; rooms are furnished ones of 3.2 to 5.2 m, seen by two neighbouring stations.

    part      two views of a lump; the overlap is drawn from 20 to 90 % of the second view
    rough     the same with holes in both views, 0.01 to 0.1 mm of noise, and 10 to 100 % of the points in the second
    cad       a view of a lump on its mesh
    room      neighbours of a ring of stations
    corner    a room with two pieces of furniture, seen from two places that look into the same corner
    bare      a room without furniture, seen by opposite stations: turned by half a turn, it looks the same
    twin      a station in a furnished room, and its neighbour in the mirror image of that room
    box       a box with rounded edges, on its mesh: three half turns fit as well as the truth
    vase      a body of revolution, on its mesh: it turns
    comb      a bar with equal teeth, of which either view shows a part
    mirror    a lump on the mesh of its mirror image
    strange   a lump on another one

'wrong': answered as unique, but off by more than 1 % of the extent. 'reached': a start from the true pose is answered
as unique; 'answered': without a start as well. error/sigma: root mean square of the six whitened errors. Seconds are
wall time of the registration alone, with its machine code compiled.

`--keep FILE` appends what became of each pair, and measures no pair again that is there; `--minutes` ends the run,
which the same command continues. Pairs are taken in turn from all kinds.

`--peers`: Open3D, KISS-Matcher and small_gicp on the same pairs. 'right': off by less than 1 % of the extent, by the
median of 'off'; 'called valid': as each of them says.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from calib.deferred_imports import open3d
from calib.geometry import Pose, rotation_vector
from calib.numerics import Floats, Ints
from calib.pointcloud import scattered_surface, surface
from calib.registration import (
    Alignment,
    SurfacePoints,
    SurfaceRegistration,
    is_closed,
    register_surfaces,
    sample_mesh,
)
from calib.synthetic import STATION_CAMERA, CloudErrors, random_furnished_room, ring, seen_from
from hw.settings import ThingSettings
from hw.simulated.things import draw_solid

_WRONG = 0.01  # of the extent
_SIDE = 0.1  # m, of a thing
_NOISE = 3e-5  # m
_OF_MESH = 200_000  # points, as in scan compare


@dataclass(frozen=True, eq=False)
class Case:
    """Two surfaces and the truth: X_first = pose @ X_second; None if they do not fit, or fit in several ways."""

    first: SurfacePoints
    second: SurfacePoints
    truth: Pose | None


@dataclass(frozen=True, eq=False)
class Row:
    """What became of a pair."""

    alignment: Alignment
    overlap: float
    reached: bool
    wrong: bool
    whitened: Floats | None
    seconds: float

    def as_line(self, pair: "PairName") -> str:
        """JSON, with the pair that it is of."""
        whitened = None if self.whitened is None else self.whitened.tolist()
        return json.dumps([pair, asdict(self) | {"alignment": self.alignment.value, "whitened": whitened}])

    @classmethod
    def of_line(cls, line: str) -> "tuple[PairName, Row]":
        """The pair and its row."""
        pair, values = json.loads(line)
        whitened = None if values["whitened"] is None else np.array(values["whitened"])
        return tuple(pair), cls(**values | {"alignment": Alignment(values["alignment"]), "whitened": whitened})

    @property
    def answered(self) -> bool:
        """Whether it was answered rightly, and a start from the truth as well."""
        return self.reached and not self.wrong and self.alignment is Alignment.UNIQUE


PairName = tuple[str, int, int]  # kind, seed, points

_HEADING = "kind     pairs  overlap %  reached  answered  wrong  ambiguous  loose  none  error/sigma  seconds"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--points", type=int, default=40_000)
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--keep", type=Path, help="file of rows")
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--peers", action="store_true", help="other programs instead, of the extra 'bench'")
    args = parser.parse_args()
    if args.peers:
        compare_peers(args.kinds, range(args.first, args.first + args.pairs), args.points)
        return
    pairs = [(kind, args.first + k, args.points) for k in range(args.pairs) for kind in args.kinds]
    rows = measure_pairs(pairs, args.keep, 60 * args.minutes, verbose=args.verbose)
    print(_HEADING)
    for kind in args.kinds:
        if own := [row for (name, _, _), row in rows.items() if name == kind]:
            print(told(kind, own))
    print(told("all", list(rows.values())))


def measure_pairs(
    pairs: Sequence[PairName], keep: Path | None, seconds: float, *, verbose: bool
) -> dict[PairName, Row]:
    """Rows of the pairs, those that are kept or that fit in the time."""
    kept = dict(map(Row.of_line, keep.read_text().splitlines())) if keep is not None and keep.exists() else {}
    rows: dict[PairName, Row] = {}
    end = time.monotonic() + seconds
    for pair in pairs:
        kind, seed, points = pair
        if pair not in kept and time.monotonic() < end:
            kept[pair] = measured(KINDS[kind](seed, points), f"{kind} {seed}", verbose)
            if keep is not None:
                with keep.open("a") as file:
                    file.write(kept[pair].as_line(pair) + "\n")
        if pair in kept:
            rows[pair] = kept[pair]
    return rows


def compare_peers(kinds: Sequence[str], seeds: Sequence[int], points: int) -> None:
    """Print a table of what other programs answer: poses that are right, wrong ones that are called valid, seconds."""
    from peer_registration import PEERS  # only where they are installed

    print(f"{'kind':8} {'peer':18} pairs  right  called valid  wrong among these   off %  seconds")
    for kind in kinds:
        cases = [KINDS[kind](seed, points) for seed in seeds]
        for name, register in PEERS.items():
            offs, valid, seconds = [], [], []
            for case in cases:
                start = time.perf_counter()
                answer = register(case.first, case.second)
                seconds.append(time.perf_counter() - start)
                offs.append(shift(answer.pose, case))
                valid.append(answer.valid)
            off = np.array(offs)
            wrong = int(np.count_nonzero(np.array(valid) & ~(off < _WRONG)))
            right = int(np.count_nonzero(off < _WRONG))
            best = f"{100 * np.median(off[off < _WRONG]):.3f}" if right else "–"
            print(
                f"{kind:8} {name:18} {len(cases):5}  {right:5}  {sum(valid):12}  {wrong:17}  {best:>6}  "
                f"{np.median(seconds):7.2f}",
                flush=True,
            )


def shift(pose: Pose, case: Case) -> float:
    """Root mean square of the points' shifts from the truth over the extent; infinite without a truth."""
    if case.truth is None:
        return np.inf
    moved, true = pose @ case.second.points, case.truth @ case.second.points
    extent = float(np.linalg.norm(np.ptp(case.second.points, axis=0)))
    return float(np.sqrt(np.mean(np.sum((moved - true) ** 2, axis=1)))) / extent


def told(kind: str, rows: list[Row]) -> str:
    """A line of the table."""
    overlap = 100 * np.array([row.overlap for row in rows])
    whitened = [row.whitened for row in rows if row.whitened is not None]
    ratio = f"{np.sqrt(np.mean(np.concatenate(whitened) ** 2)):.2f}" if whitened else "–"
    reached, answered, wrong = (sum(getattr(row, name) for row in rows) for name in ("reached", "answered", "wrong"))
    others = (Alignment.AMBIGUOUS, Alignment.LOOSE, Alignment.NONE)
    ambiguous, loose, none = (sum(row.alignment is other for row in rows) for other in others)
    seconds = np.median([row.seconds for row in rows])
    return (
        f"{kind:8} {len(rows):5}  {overlap.min():4.0f}–{overlap.max():3.0f}  {reached:7}  {answered:8}  {wrong:5}  "
        f"{ambiguous:9}  {loose:5}  {none:4}  {ratio:>11}  {seconds:7.2f}"
    )


def measured(case: Case, name: str, verbose: bool) -> Row:
    start = time.perf_counter()
    found = register_surfaces(case.first, case.second)
    seconds = time.perf_counter() - start
    off, whitened = errors(found, case)
    reached = False
    if case.truth is not None:
        from_truth = register_surfaces(case.first, case.second, starts=case.truth[None])
        reached = from_truth.alignment is Alignment.UNIQUE and errors(from_truth, case)[0] < _WRONG
    wrong = found.alignment is Alignment.UNIQUE and not off < _WRONG
    row = Row(found.alignment, true_overlap(case), reached, wrong, None if wrong else whitened, seconds)
    if verbose:
        ratio = np.nan if whitened is None else np.sqrt(np.mean(whitened**2))
        print(
            f"  {name}: {found.alignment.value}, off {off:.5f}, reached {reached}, overlap {row.overlap:.2f},", end=" "
        )
        print(f"error/sigma {ratio:.2f}, {seconds:.2f} s", flush=True)
        for pose in ([] if found.best is None else [found.best]) + [*found.alternatives[:3]]:
            print(f"      {pose.share:.3f} agrees: {pose.agreeing:.0f} cells, {pose.contradicting:.1f} against")
    return row


def errors(found: SurfaceRegistration, case: Case) -> tuple[float, Floats | None]:
    """Root mean square of the points' shifts over the extent, and the six errors of the pose, whitened."""
    if case.truth is None or found.best is None:
        return np.inf, None
    off = shift(found.best.pose, case)
    if not np.isfinite(found.covariance).all():
        return off, None
    change = found.best.pose @ case.truth.inverse()
    step = np.append(rotation_vector(change.rotation), change @ found.centre - found.centre)
    return off, np.linalg.solve(np.linalg.cholesky(found.covariance), step)


def true_overlap(case: Case) -> float:
    """Share of the second surface that the first one has."""
    if case.truth is None:
        return 0.0
    some = case.truth @ case.second.points[:: max(1, len(case.second.points) // 3000)]
    tree = cKDTree(case.first.points)
    spacing = np.median(np.asarray(tree.query(case.first.points[::97], 2)[0])[:, 1])
    return float(np.mean(tree.query(some)[0] < 3 * spacing))


def lump(seed: int, kind: str = "lump") -> tuple[Floats, Ints]:
    """Vertices and triangles of a thing."""
    settings = ThingSettings.model_validate({"kind": kind, "size_m": _SIDE})
    solid = draw_solid(settings, np.random.default_rng([seed, 3]))
    return solid.vertices, solid.triangles


def seen(
    mesh: tuple[Floats, Ints], towards: Floats, points: int, rng: np.random.Generator, noise: float = _NOISE
) -> SurfacePoints:
    """What a rig 0.5 m away in a direction (3,) sees of a thing, with a projector beside the camera."""
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(mesh[0].astype(np.float32)), o3d.core.Tensor(mesh[1].astype(np.uint32)))
    eye = 0.5 * towards
    side = int(np.sqrt(points / 0.45))
    right = np.cross(towards, [0.3, 0.5, 0.8])
    right /= np.linalg.norm(right)
    down = np.cross(towards, right)
    grid = np.linspace(-0.15, 0.15, side)
    x, y = np.meshgrid(grid, grid)
    ways = -towards + x[..., None] * right + y[..., None] * down
    ways = (ways / np.linalg.norm(ways, axis=-1, keepdims=True)).reshape(-1, 3)
    rays = np.hstack([np.broadcast_to(eye, ways.shape), ways]).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor(rays))
    depth, normals = hit["t_hit"].numpy().astype(np.float64), hit["primitive_normals"].numpy().astype(np.float64)
    there = np.isfinite(depth) & (np.abs(np.sum(normals * ways, axis=1)) > 0.2)
    place = eye + np.where(there, depth, 0)[:, None] * ways
    lamp = eye + 0.1 * right
    lit = place - lamp
    length = np.linalg.norm(lit, axis=1, keepdims=True)
    shadow = scene.cast_rays(
        o3d.core.Tensor(np.hstack([np.broadcast_to(lamp, lit.shape), lit / length]).astype(np.float32))
    )
    there &= shadow["t_hit"].numpy() > length[:, 0] - 1e-4
    place += noise * rng.standard_normal((len(place), 1)) * ways
    return SurfacePoints(place[there])


def towards(rng: np.random.Generator) -> Floats:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def random_pose(rng: np.random.Generator, far: float = 1.0) -> Pose:
    return Pose(Rotation.random(rng=rng).as_matrix(), far * rng.standard_normal(3))


def placed(points: SurfacePoints, pose: Pose) -> SurfacePoints:
    normals = None if points.normals is None else pose.rotate(points.normals)
    return SurfacePoints(pose @ points.points, normals)


def sampled(mesh: tuple[Floats, Ints]) -> SurfacePoints:
    """Points of a mesh with outward normals, without noise."""
    points, normals = sample_mesh(*mesh, _OF_MESH)
    return SurfacePoints(points, normals, 0.0, is_closed=is_closed(*mesh))


def with_normals(points: SurfacePoints, eye: Floats) -> SurfacePoints:
    """With normals towards the scanner, as files of scanners have them."""
    normals = scattered_surface((points.points - eye)[None].astype(np.float32)).normals[0].astype(np.float64)
    return SurfacePoints(points.points, normals)


def two_sides(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Unit vectors (3,) from which a thing is seen twice, 10 to 95° apart."""
    first = towards(rng)
    aside = np.cross(first, towards(rng))
    aside /= np.linalg.norm(aside)
    angle = np.radians(rng.uniform(10, 95))
    return first, np.cos(angle) * first + np.sin(angle) * aside


def _part(seed: int, points: int) -> Case:
    rng = np.random.default_rng([seed, 5])
    mesh, (one, other) = lump(seed), two_sides(rng)
    first = seen(mesh, one, points, rng)
    second = seen(mesh, other, int(points * rng.uniform(0.3, 1.0)), rng)
    if seed % 2:  # files with normals, or without
        first, second = with_normals(first, 0.5 * one), with_normals(second, 0.5 * other)
    pose = random_pose(rng, 0.3)
    return Case(first, placed(second, pose.inverse()), pose)


def _rough(seed: int, points: int) -> Case:
    rng = np.random.default_rng([seed, 12])
    mesh, (one, other) = lump(seed), two_sides(rng)
    noises = 1e-5 * 10 ** rng.uniform(0, 1, 2)
    first = with_holes(seen(mesh, one, points, rng, noises[0]), rng)
    second = with_holes(seen(mesh, other, int(points * rng.uniform(0.1, 1.0)), rng, noises[1]), rng)
    if seed % 2:
        first, second = with_normals(first, 0.5 * one), with_normals(second, 0.5 * other)
    pose = random_pose(rng, 0.3)
    return Case(first, placed(second, pose.inverse()), pose)


def with_holes(view: SurfacePoints, rng: np.random.Generator, count: int = 8) -> SurfacePoints:
    """Without the points around some of them, 3 to 10 mm wide, as where a surface is too dark."""
    kept = np.ones(len(view.points), np.bool_)
    for middle in view.points[rng.integers(0, len(view.points), count)]:
        kept &= np.linalg.norm(view.points - middle, axis=1) > rng.uniform(0.0015, 0.005)
    return SurfacePoints(view.points[kept])


def _cad(seed: int, points: int) -> Case:
    rng = np.random.default_rng([seed, 6])
    mesh, pose = lump(seed), random_pose(rng, 0.3)
    one = towards(rng)
    view = seen(mesh, one, points, rng)
    view = with_normals(view, 0.5 * one) if seed % 2 else view
    return Case(sampled(mesh), placed(view, pose.inverse()), pose)


def _fitting_in_several_ways(kind: str) -> Callable[[int, int], Case]:
    def case(seed: int, points: int) -> Case:
        rng = np.random.default_rng([seed, 7])
        mesh = lump(seed, kind)
        view = seen(mesh, towards(rng), points, rng)
        return Case(sampled(mesh), placed(view, random_pose(rng, 0.3)), None)

    return case


def _mirror(seed: int, points: int) -> Case:
    rng = np.random.default_rng([seed, 8])
    vertices, triangles = lump(seed)
    mirrored = vertices * [1.0, 1.0, -1.0], triangles[:, ::-1]
    one = towards(rng)
    view = with_normals(seen((vertices, triangles), one, points, rng), 0.5 * one)
    return Case(sampled(mirrored), placed(view, random_pose(rng, 0.3)), None)


def _strange(seed: int, points: int) -> Case:
    rng = np.random.default_rng([seed, 9])
    one, other = towards(rng), towards(rng)
    first = seen(lump(seed), one, points, rng)
    second = seen(lump(seed + 1000), other, points, rng)
    if seed % 2:
        first, second = with_normals(first, 0.5 * one), with_normals(second, 0.5 * other)
    return Case(first, placed(second, random_pose(rng, 0.3)), None)


def _comb(seed: int, points: int) -> Case:
    rng = np.random.default_rng([seed, 10])
    o3d = open3d()
    teeth = [(0.006 + 0.01 * k, 0.004) for k in range(9)]
    boxes = [o3d.geometry.TriangleMesh.create_box(0.1, 0.02, 0.01)]
    for at, wide in teeth:
        boxes.append(o3d.geometry.TriangleMesh.create_box(wide, 0.02, 0.012).translate((at, 0, 0.009)))
    whole = boxes[0]
    for box in boxes[1:]:
        whole += box
    mesh = np.asarray(whole.vertices) - [0.05, 0.01, 0.01], np.asarray(whole.triangles)
    way = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5), 1.0])
    views = [seen(mesh, way / np.linalg.norm(way), points, rng) for _ in range(2)]
    kept = [
        view.points[np.abs(view.points[:, 0] - at) < 0.028] for view, at in zip(views, (-0.015, 0.015), strict=True)
    ]
    return Case(SurfacePoints(kept[0]), placed(SurfacePoints(kept[1]), random_pose(rng, 0.3)), None)


def _stations(seed: int, pieces: int, step: int, *, shape: float = 0.0, known: bool = True) -> Case:
    rng = np.random.default_rng([seed, 11])
    room = random_furnished_room(rng, pieces)
    places = ring(rng, room, 6, 30.0 if step < 0 else 60.0)
    clouds = []
    for place in (places[0], places[abs(step)]):
        cloud = seen_from(room, place, rng, CloudErrors(shape=shape)).points
        normals = surface(cloud, float(np.mean(STATION_CAMERA.focal_px))).normals
        there = np.isfinite(cloud[..., 2]) & np.isfinite(normals[..., 2])
        measured_points = cloud[there].astype(np.float64)
        clouds.append(SurfacePoints(measured_points, normals[there].astype(np.float64), eye=np.zeros(3)))
    return Case(clouds[0], clouds[1], places[0].inverse() @ places[abs(step)] if known else None)


def _twin(seed: int, _: int) -> Case:
    case = _stations(seed, 8, 1, known=False)
    mirrored, normals = np.array([-1.0, 1.0, 1.0]), case.second.normals
    assert normals is not None
    return Case(case.first, SurfacePoints(mirrored * case.second.points, mirrored * normals, eye=np.zeros(3)), None)


KINDS: dict[str, Callable[[int, int], Case]] = {
    "part": _part,
    "rough": _rough,
    "cad": _cad,
    "room": lambda seed, _: _stations(seed, 8, 1),
    "corner": lambda seed, _: _stations(seed, 2, -1),
    "bare": lambda seed, _: _stations(seed, 0, 3, known=False),
    "twin": _twin,
    "box": _fitting_in_several_ways("box"),
    "vase": _fitting_in_several_ways("vase"),
    "comb": _comb,
    "mirror": _mirror,
    "strange": _strange,
}


if __name__ == "__main__":
    main()
