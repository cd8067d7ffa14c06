"""Clouds of any scanners in one frame: pairs registered without a first guess, poses from all pairs, and one cloud."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Floats
from calib.registration import (
    Alignment,
    PairPose,
    PoseGraph,
    SurfacePoints,
    SurfaceRegistration,
    register_surfaces,
    solve_pose_graph,
)
from scanner.comparing.outer_sides import register_either_side, turned_note
from scanner.comparing.surfaces import NO_UNIT, ComparedSurface, read_compared
from scanner.errors import InputError
from scanner.io import write_scalar_ply
from scanner.quantities import metres_per, plain, shown_unit
from scanner.rendering import FACE_COLOURS, PURPLE, VERMILION, YELLOW
from scanner.results import Verdict

REGISTER_FILE, REGISTERED_FILE = "register.json", "registered.ply"
_FORMAT = 1
_COLOURS = (*FACE_COLOURS, PURPLE, VERMILION, YELLOW)
_WORDS = {
    Alignment.AMBIGUOUS: "fit together in several ways",
    Alignment.LOOSE: "fit together, but may slide or turn",
    Alignment.NONE: "do not fit together anywhere",
}


@dataclass(frozen=True, eq=False)
class RegisteredPair:
    """Two of the clouds, by their numbers from 0."""

    first: int
    second: int
    registration: SurfaceRegistration


@dataclass(frozen=True, eq=False)
class RegisteredClouds:
    """Several clouds in the frame and the unit of the first of the largest group."""

    names: tuple[str, ...]
    unit: str
    scales: tuple[float, ...]
    """Factors of each cloud's lengths into `unit`."""
    pairs: tuple[RegisteredPair, ...]
    graph: PoseGraph
    clouds: tuple[ComparedSurface, ...]
    notes: tuple[str, ...]

    @property
    def joined(self) -> tuple[int, ...]:
        """Numbers of the clouds that have a place, in their order."""
        return tuple(sorted(self.graph.places))

    @property
    def left_out(self) -> tuple[int, ...]:
        """Numbers of the others."""
        return tuple(k for k in range(len(self.names)) if k not in self.graph.places)

    def points(self, number: int) -> Floats:
        """The points of a cloud in the common frame, (N, 3)."""
        return self.graph.places[number] @ (self.scales[number] * self.clouds[number].points)

    def sigmas(self, number: int) -> tuple[float, float]:
        """Standard deviations of a cloud's rotation in degrees, and of its middle's position."""
        turn, shift = self.graph.sigmas(number, np.median(self.points(number), axis=0))
        return float(np.degrees(turn)), shift


Track = Callable[[Iterable[tuple[int, int]], int, str], Iterator[tuple[int, int]]]


def register_clouds(paths: Sequence[Path], track: Track) -> RegisteredClouds:
    """Register clouds, results or meshes, two or more, all pairs of them; `track` shows progress. Raises InputError."""
    if len(paths) < 2:
        raise InputError("expected two clouds or more, found one")
    clouds = [read_compared(path) for path in paths]
    notes = [note for cloud in clouds for note in cloud.notes]
    unit, scales = _units(clouds, notes)
    sampled = [_scaled(cloud.sampled, scale) for cloud, scale in zip(clouds, scales, strict=True)]
    numbers = list(combinations(range(len(clouds)), 2))
    pairs = []
    for first, second in track(numbers, len(numbers), "Registering"):
        known = clouds[first].knows_outside, clouds[second].knows_outside
        try:
            registration, turned = register_either_side(sampled[first], sampled[second], register_surfaces, known)
        except ValueError as error:
            raise InputError(f"{paths[first]} and {paths[second]} cannot be registered: {error}") from error
        except ImportError as error:
            raise InputError(str(error)) from error
        pairs.append(RegisteredPair(first, second, registration))
        if turned is not None:
            names = clouds[first].name, clouds[second].name
            notes.append(turned_note(*(names if turned == 0 else names[::-1])))
    middles = [np.median(each.points, axis=0) for each in sampled]
    graph = _graph(pairs, middles, len(clouds))
    return RegisteredClouds(
        tuple(cloud.name for cloud in clouds), unit, tuple(scales), tuple(pairs), graph, tuple(clouds), tuple(notes)
    )


def _units(clouds: Sequence[ComparedSurface], notes: list[str]) -> tuple[str, list[float]]:
    """The common unit, and the factors of the clouds' lengths; what had to be supposed goes to `notes`."""
    known = [cloud for cloud in clouds if cloud.has_length]
    if not known:
        units = {cloud.unit for cloud in clouds}
        if len(units) > 1:
            raise InputError(
                "these clouds have no length in common: some are in baselines, others do not state their unit; "
                "scan compare --scale-free finds the scale of two"
            )
        return clouds[0].unit or NO_UNIT, [1.0] * len(clouds)
    unit, scales = str(known[0].unit), []
    for cloud in clouds:
        if cloud.has_length:
            scales.append(metres_per(str(cloud.unit)) / metres_per(unit))
            continue
        if cloud.unit is not None:
            raise InputError(
                f"{cloud.name}: has no known length: make it again with a scale, as in --set scale.baseline_m=0.4"
            )
        scales.append(1.0)
        notes.append(f"{cloud.name} does not state its unit: taken as {unit}.")
    return unit, scales


def _scaled(surface: SurfacePoints, scale: float) -> SurfacePoints:
    noise = None if surface.noise is None else scale * surface.noise
    eye = None if surface.eye is None else scale * surface.eye
    return replace(surface, points=scale * surface.points, noise=noise, eye=eye)


def _graph(pairs: Sequence[RegisteredPair], middles: Sequence[Floats], count: int) -> PoseGraph:
    """The largest group that unique pairs connect, in the frame of its first cloud."""
    edges = []
    for pair in pairs:
        registration = pair.registration
        if (
            registration.alignment is Alignment.UNIQUE
            and registration.best is not None
            and np.isfinite(registration.covariance).all()
        ):
            to, of = (Pose(np.eye(3), middles[k]) for k in (pair.first, pair.second))
            about = to.inverse() @ registration.best.pose @ of
            centre = registration.centre - middles[pair.first]
            edges.append(
                PairPose(pair.first, pair.second, about, centre, registration.covariance, registration.tolerance)
            )
    graphs: list[PoseGraph] = []
    for root in range(count):
        if not any(root in graph.places for graph in graphs):
            graphs.append(solve_pose_graph(edges, root))
    graph = max(graphs, key=lambda graph: len(graph.places))
    start = Pose(np.eye(3), middles[min(graph.places)])
    places = {k: start @ place @ Pose(np.eye(3), -middles[k]) for k, place in graph.places.items()}
    by_twist = np.kron(np.eye(len(places)), start.adjoint)
    covariance = by_twist @ graph.covariance @ by_twist.T
    return PoseGraph(places, covariance, graph.chi2, graph.freedom, graph.dropped, graph.contradict)


def registration_verdict(clouds: RegisteredClouds) -> Verdict:
    """Whether all clouds have a certain place."""
    joined, total = len(clouds.joined), len(clouds.names)
    reasons, unit = list(_reasons(clouds)), shown_unit(clouds.unit)
    advice = "Scan more of what they have in common, or more clouds in between."
    if clouds.graph.contradict:
        return Verdict(
            "refused", "Pairs of clouds contradict each other, so that no place is certain.", tuple(reasons), advice
        )
    if joined < 2:
        return Verdict("refused", "No two of the clouds fit together in one way.", tuple(reasons), advice)
    largest = max(clouds.sigmas(k)[1] for k in clouds.joined)
    if joined < total:
        return Verdict(
            "fair", f"{joined} of {total} clouds fit together, to ± {unit.error(largest)}.", tuple(reasons), advice
        )
    return Verdict("good", f"All {total} clouds fit together, to ± {unit.error(largest)}.", tuple(reasons))


def _reasons(clouds: RegisteredClouds) -> Iterator[str]:
    graph = clouds.graph
    if graph.freedom and not graph.contradict:
        yield f"Pairs agree: χ² = {plain(graph.chi2, 1)}, where {graph.freedom} is expected."
    for wrong in graph.dropped:
        names = f"{clouds.names[wrong.first]} and {clouds.names[wrong.second]}"
        yield f"{names} fit in a way that contradicts the others; left out."
    for number in clouds.left_out:
        own = [pair for pair in clouds.pairs if number in (pair.first, pair.second)]
        for pair in own:
            if pair.registration.alignment is not Alignment.UNIQUE:
                words = _WORDS[pair.registration.alignment]
                if any(pose.is_mirrored for pose in pair.registration.alternatives):
                    words = "have like walls, or flat faces, but so has the mirror image"
                yield f"{clouds.names[pair.first]} and {clouds.names[pair.second]} {words}."


def registration_rows(clouds: RegisteredClouds) -> list[tuple[str, ...]]:
    """Rows of name, points, sigma of the rotation and of the position."""
    unit, rows = shown_unit(clouds.unit), list[tuple[str, ...]]()
    for number, name in enumerate(clouds.names):
        if number not in clouds.graph.places:
            rows.append((name, f"{len(clouds.clouds[number].points):,}", "–", "left out"))
            continue
        turn, shift = clouds.sigmas(number)
        is_first = number == clouds.joined[0]
        told = ("frame", "frame") if is_first else (f"± {plain(turn, 4)}", f"± {unit.number(shift)}")
        rows.append((name, f"{len(clouds.clouds[number].points):,}", *told))
    return rows


def write_registered_cloud(path: Path, clouds: RegisteredClouds) -> None:
    """All points that have a place, each cloud in a colour of its own and with its number from 1. Raises OSError."""
    points = [clouds.points(k) for k in clouds.joined]
    normals = [_normals(clouds, k) for k in clouds.joined]
    colours = [_colour(k, len(each)) for k, each in zip(clouds.joined, points, strict=True)]
    number = [np.full(len(each), k + 1.0) for k, each in zip(clouds.joined, points, strict=True)]
    frame = f"common frame: that of {Path(clouds.names[clouds.joined[0]]).name}"
    scalars = {"cloud": np.concatenate(number)}
    arrays = np.concatenate(points), np.concatenate(normals), np.concatenate(colours)
    write_scalar_ply(path, *arrays, scalars, clouds.unit, frame)


def _normals(clouds: RegisteredClouds, number: int) -> Floats:
    normals = clouds.clouds[number].normals
    return (
        np.zeros_like(clouds.clouds[number].points) if normals is None else clouds.graph.places[number].rotate(normals)
    )


def _colour(number: int, count: int) -> NDArray[np.uint8]:
    return np.tile(np.array(_COLOURS[number % len(_COLOURS)], np.uint8), (count, 1))


def write_registration(path: Path, clouds: RegisteredClouds) -> None:
    """Write poses and sigmas, X_common = rotation (scale X) + translation, and what became of pairs. Raises OSError."""
    document = {
        "format": _FORMAT,
        "unit": clouds.unit,
        "verdict": registration_verdict(clouds).headline,
        "chi2": clouds.graph.chi2,
        "freedom": clouds.graph.freedom,
        "clouds": [_cloud_document(clouds, number) for number in range(len(clouds.names))],
        "covariance_of": [k + 1 for k in clouds.graph.places],
        "covariance": clouds.graph.covariance.tolist(),
        "pairs": [_pair_document(clouds, pair) for pair in clouds.pairs],
        "notes": list(clouds.notes),
    }
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _cloud_document(clouds: RegisteredClouds, number: int) -> dict[str, Any]:
    entry: dict[str, Any] = {"number": number + 1, "name": clouds.names[number], "scale": clouds.scales[number]}
    place = clouds.graph.places.get(number)
    if place is None:
        return entry | {"joined": False}
    turn, shift = clouds.sigmas(number)
    return entry | {
        "joined": True,
        "rotation": place.rotation.tolist(),
        "translation": place.translation.tolist(),
        "sigma": {"rotation_deg": turn, "position": shift},
    }


def _pair_document(clouds: RegisteredClouds, pair: RegisteredPair) -> dict[str, Any]:
    registration = pair.registration
    entry: dict[str, Any] = {
        "first": pair.first + 1,
        "second": pair.second + 1,
        "alignment": registration.alignment.value,
        "dropped": any((each.first, each.second) == (pair.first, pair.second) for each in clouds.graph.dropped),
    }
    if registration.best is not None:
        entry |= {"overlap": list(registration.best.overlap), "agreeing_share": registration.best.share}
    return entry
