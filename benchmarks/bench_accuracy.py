"""Errors of the decoder's matches in simulated rooms, for each preset.

    python benchmarks/bench_accuracy.py [--seeds 0 1 2] [--presets quick standard concave]

All light transport is on and walls and floor have albedo 0.8. 'Well lit' pixels are lit directly by the projector, with
all pixels around them, and reach a tenth of the camera's range. The second table concerns calibrations: the mean error
of the matches in cells of 16 × 16 camera pixels on walls and floor, root mean square over the cells at a given
distance from the nearest crease.
"""

import argparse
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from calib.numerics import Bools, Floats, Image
from hw.settings import SimulatedRigSettings
from hw.simulated import GroundTruth, SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.decoding import Decoder, Decoding
from scanner.patterns import PRESETS, PresetName, draw

CAMERA, PROJECTOR = (1224, 1024), (854, 480)
CELL_PX = 16
DISTANCES_PX = (0, 3, 5, 8, 12, 20, 40, np.inf)
FACES = 3
WELL_LIT = 0.1


@dataclass(frozen=True)
class Compared:
    """Per camera pixel (H, W): `error_px` (H, W, 2) and `sigma_px`, NaN without match; `well_lit`; `crease_px`, the
    distance to the nearest pixel of another face, infinite off the faces.
    """

    error_px: Floats
    sigma_px: Floats
    well_lit: Bools
    crease_px: Floats


def decoded(room: SimulatedRoom, preset: PresetName) -> tuple[Decoding, int, Image]:
    """The decoding, the number of frames, and the white frame."""
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    patterns = PRESETS[preset].patterns(projector.size)
    decoder = Decoder(patterns, projector.size)
    frames: list[Image] = []
    for pattern in patterns:
        projector.show(draw(pattern, projector.size))
        image = camera.grab().image
        decoder.add(image)
        frames[:1] = frames[:1] or [image]
    return decoder.finish(), len(patterns), frames[0]


def compared(decoding: Decoding, white: Image, truth: GroundTruth) -> Compared:
    shape = decoding.reasons.shape
    matches = decoding.matches
    assert matches.sigma_px is not None
    x, y = np.rint(matches.camera_px).astype(int).T
    error, sigma = np.full((*shape, 2), np.nan), np.full(shape, np.nan)
    error[y, x] = matches.projector_px - truth.projector_px[y, x]
    sigma[y, x] = matches.sigma_px
    lit = np.isfinite(truth.projector_px[..., 0]).astype(np.uint8)
    well_lit = (cv2.erode(lit, np.ones((3, 3), np.uint8)) > 0) & (white >= WELL_LIT * np.iinfo(white.dtype).max)
    return Compared(error, sigma, well_lit, crease_distance(truth))


def crease_distance(truth: GroundTruth) -> Floats:
    distance = np.full(truth.label.shape, np.inf)
    for face in range(FACES):
        elsewhere = (truth.label < FACES) & (truth.label != face)
        to_other = cv2.distanceTransform((~elsewhere).astype(np.uint8), cv2.DIST_L2, 5)
        distance[truth.label == face] = to_other[truth.label == face]
    return distance


def cell_biases(result: Compared) -> tuple[Floats, Floats]:
    """Mean errors (n, 2) of the cells of which at least half is matched on the faces, and their distances (n,)."""
    height, width = (CELL_PX * (size // CELL_PX) for size in result.sigma_px.shape)
    there = np.isfinite(result.error_px[..., 0]) & np.isfinite(result.crease_px)

    def total(values: Floats) -> Floats:
        cut = np.where(there, values, 0.0)[:height, :width]
        cells: Floats = cut.reshape(height // CELL_PX, CELL_PX, width // CELL_PX, CELL_PX).sum(axis=(1, 3))
        return cells

    count = total(np.ones(there.shape))
    filled = count > CELL_PX**2 / 2
    with np.errstate(invalid="ignore"):
        means = [total(values) / count for values in (*np.moveaxis(result.error_px, 2, 0), result.crease_px)]
    return np.stack([mean[filled] for mean in means[:2]], axis=1), means[2][filled]


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def by_distance(values: Floats, distance: Floats) -> list[str]:
    return [f"{rms(values[(distance >= low) & (distance < high)]):.4f}" for low, high in pairwise(DISTANCES_PX)]


def summary(name: str, frames: int, results: list[Compared]) -> list[str]:
    error = np.concatenate([result.error_px[np.isfinite(result.error_px[..., 0])] for result in results])
    sigma = np.concatenate([result.sigma_px[np.isfinite(result.error_px[..., 0])] for result in results])
    length = np.linalg.norm(error, axis=1)
    kept = sum(np.count_nonzero(np.isfinite(result.sigma_px) & result.well_lit) for result in results)
    well_lit = sum(np.count_nonzero(result.well_lit) for result in results)
    return [
        name,
        str(frames),
        f"{np.median(length):.4f}",
        f"{np.percentile(length, 99):.3f}",
        f"{np.percentile(length, 99.9):.3f}",
        f"{kept / well_lit:.2%}",
        f"{np.std(error / sigma[:, None]):.2f}",
    ]


def titled(title: str, columns: list[str]) -> Table:
    table = Table(title=title)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--presets", nargs="+", choices=list(PRESETS), default=list(PRESETS))
    options = parser.parse_args()
    results: dict[PresetName, list[Compared]] = {preset: [] for preset in options.presets}
    frames = {}
    for seed in options.seeds:
        room = SimulatedRoom(SimulatedRigSettings(seed=seed, albedo=0.8), CAMERA, PROJECTOR)
        truth = room.ground_truth()
        for preset in options.presets:
            decoding, frames[preset], white = decoded(room, preset)
            results[preset].append(compared(decoding, white, truth))
    show(results, frames)


def show(results: dict[PresetName, list[Compared]], frames: dict[PresetName, int]) -> None:
    columns = ["preset", "frames", "median", "99 %", "99.9 %", "well lit pixels kept", "error / sigma, std"]
    figures = titled("Error of the matches, projector pixels", columns)
    limits = pairwise(DISTANCES_PX)
    distances = titled("By distance from a crease, camera pixels; rms", ["", *(f"{a:g}–{b:g}" for a, b in limits)])
    for preset, of_rooms in results.items():
        figures.add_row(*summary(preset, frames[preset], of_rooms))
        crease, sigma = (
            np.concatenate([getattr(r, name).ravel() for r in of_rooms]) for name in ("crease_px", "sigma_px")
        )
        error = np.concatenate([result.error_px.reshape(-1, 2) for result in of_rooms])
        there = np.isfinite(error[:, 0]) & np.isfinite(crease)
        biases, where = (np.concatenate(part) for part in zip(*map(cell_biases, of_rooms), strict=True))
        distances.add_row(f"{preset}: error of a match", *by_distance(error[there], crease[there]))
        ratio = error[there] / sigma[there, None]
        distances.add_row("error / sigma", *by_distance(ratio, crease[there]))
        distances.add_row("mean error of a cell", *by_distance(biases, where), end_section=True)
    console = Console(width=120)
    console.print(figures)
    console.print(distances)


if __name__ == "__main__":
    main()
