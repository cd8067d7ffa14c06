"""Share of matches with a wrong face, and the time it takes.

    python benchmarks/bench_faces.py --rooms 30 --boxes 10 --seed 0

Rooms with furniture (parallel and rotated boxes, a sphere, sometimes a hidden vertex; k1 from −0.1 to 0.05 on either
lens, 0.03 to 0.3 px of noise, up to 5 % outliers, errors along the creases) and boxes seen from outside, at 1224 × 1024
camera pixels. 'wrong': labelled matches that lie on another surface; 'labelled': share of a face's true matches that
are labelled, the worst of the three; 'off': how far from perpendicular the three chosen surfaces really are.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from calib.geometry import Matches
from calib.plane_segmentation import find_faces
from calib.refusal import RefusalError
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.scenes import Scene, Score, box_on_table, furnished_room, score


def measure(name: str, scene: Scene) -> Score | None:
    camera, projector = scene.calibration.camera, scene.calibration.projector
    begin = time.perf_counter()
    try:
        faces = find_faces(scene.matches, (camera.width, camera.height), (projector.width, projector.height))
    except RefusalError as refusal:
        print(f"{name:8} {len(scene.matches):8}  refused: {refusal.reason}")
        return None
    seconds = time.perf_counter() - begin
    assert faces.matches.face is not None
    result = score(scene, faces.matches.face)
    print(
        f"{name:8} {len(scene.matches):8} {100 * result.wrong:8.4f} % {100 * result.labelled.min():8.1f} % "
        f"{result.off_square_deg:6.2f}° {len(faces.planes):6} {seconds:7.2f} s"
    )
    return result


def summarise(results: list[Score | None]) -> None:
    found = [result for result in results if result is not None]
    wrong = 100 * np.array([result.wrong for result in found])
    print(
        f"{len(found)} of {len(results)} answered; wrong {wrong.mean():.4f} % on average, {wrong.max():.4f} % at most; "
        f"labelled {100 * min(result.labelled.min() for result in found):.1f} % at least; "
        f"not perpendicular: {sum(result.off_square_deg > 0.01 for result in found)}\n"
    )


def growth(rng: np.random.Generator) -> None:
    print("matches     time")
    for count in (10_000, 100_000, 400_000, 1_000_000, 5_000_000):
        matches = random_capture(rng, count=count, outliers=0.03).matches
        unlabelled = Matches(matches.camera_px, matches.projector_px)
        begin = time.perf_counter()
        find_faces(
            unlabelled, (PAPER_CAMERA.width, PAPER_CAMERA.height), (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
        )
        print(f"{len(matches):8} {time.perf_counter() - begin:7.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=30)
    parser.add_argument("--boxes", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("scene     matches      wrong   labelled     off  planes    time")
    rooms = range(arguments.seed, arguments.seed + arguments.rooms)
    summarise([measure(f"room {seed}", furnished_room(np.random.default_rng([seed, 0]))) for seed in rooms])
    boxes = range(arguments.seed, arguments.seed + arguments.boxes)
    summarise([measure(f"box {seed}", box_on_table(np.random.default_rng([seed, 1]))) for seed in boxes])
    growth(np.random.default_rng(arguments.seed))


if __name__ == "__main__":
    main()
