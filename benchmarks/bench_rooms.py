"""Whole scans of simulated rooms compared with the truth: decoding, faces, both calibrations, cloud.

    python benchmarks/bench_rooms.py --seeds 0 1 2 3 4 5

All light transport is on, the default sequence is shown, the camera's principal point is given. 'calibration' is the
mean absolute error of (f_c, f_p, x_p, y_p); 'square' takes the corner as exactly square (which these rooms are), '0.3°'
allows for ordinary walls.
"""

import argparse
import time

import numpy as np

from calib.geometry import Matches, intersect
from calib.plane_segmentation import find_faces
from calib.refusal import RefusalError
from calib.self_calibration import Method, PrincipalPoint, SelfCalibration, self_calibrate
from hw.settings import SimulatedRigSettings
from hw.simulated import GroundTruth, SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.decoding import Decoder, Decoding
from scanner.patterns import draw, sequence_for
from scanner.quantities import intrinsic_errors_percent

METHODS: tuple[tuple[str, Method, float], ...] = (
    ("paper", "paper", 0.0),
    ("square", "refined", 0.0),
    ("0.3°", "refined", 0.3),
)


def decoded(room: SimulatedRoom, projector_size: tuple[int, int]) -> Decoding:
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)
    patterns = sequence_for(projector_size)
    decoder = Decoder(patterns, projector_size)
    for pattern in patterns:
        projector.show(draw(pattern, projector_size))
        decoder.add(camera.grab().image)
    return decoder.finish()


def decoding_figures(matches: Matches, truth: GroundTruth) -> str:
    x, y = np.rint(matches.camera_px).astype(int).T
    error = np.linalg.norm(matches.projector_px - truth.projector_px[y, x], axis=1)
    lit = np.isfinite(truth.projector_px[..., 0])
    kept = np.zeros(lit.shape, bool)
    kept[y, x] = True
    sure = np.isfinite(error)
    return (
        f"median {np.median(error[sure]):.3f} px, 99 % {np.percentile(error[sure], 99):.2f}, "
        f"99.9 % {np.percentile(error[sure], 99.9):.2f}, kept {100 * (kept & lit).sum() / lit.sum():.1f} % of the lit, "
        f"{100 * (~sure).mean():.2f} % of the kept unlit"
    )


def face_figures(matches: Matches, truth: GroundTruth) -> str:
    assert matches.face is not None
    x, y = np.rint(matches.camera_px).astype(int).T
    true = truth.label[y, x]
    wrong = 0
    for face in range(3):
        labels = true[matches.face == face]
        wrong += int((labels != np.bincount(labels).argmax()).sum())
    labelled = int((matches.face >= 0).sum())
    return f"{100 * wrong / labelled:.3f} % wrongly labelled, {100 * labelled / (true <= 2).sum():.1f} % of the walls"


def cloud_error(matches: Matches, found: SelfCalibration, truth: GroundTruth, baseline_m: float) -> float:
    """Median distance of the points from the truth, relative to their distance, with the baseline known."""
    x, y = np.rint(matches.camera_px).astype(int).T
    points = intersect(matches, found.calibration).points * baseline_m
    true = truth.points_m[y, x]
    return float(np.nanmedian(np.linalg.norm(points - true, axis=1) / np.linalg.norm(true, axis=1)))


def run(seed: int, camera_size: tuple[int, int], projector_size: tuple[int, int]) -> dict[str, float]:
    start = time.perf_counter()
    room = SimulatedRoom(SimulatedRigSettings(seed=seed), camera_size, projector_size)
    decoding = decoded(room, projector_size)
    truth, calibration = room.ground_truth(), room.calibration
    print(f"seed {seed}: {len(decoding.matches)} matches after {time.perf_counter() - start:.0f} s")
    print("  decoding:", decoding_figures(decoding.matches, truth))
    matches = find_faces(decoding.matches, camera_size, projector_size).matches
    print("  faces:", face_figures(matches, truth))
    means = {}
    for name, method, squareness_deg in METHODS:
        try:
            found = self_calibrate(
                matches,
                camera_size,
                projector_size,
                principal_point=PrincipalPoint(calibration.camera.principal_point_px, 0.0),
                method=method,
                squareness_deg=squareness_deg,
            )
        except RefusalError as refusal:
            print(f"  calibration, {name}: refused. {refusal}")
            continue
        errors = intrinsic_errors_percent(found.calibration, calibration)
        means[name] = float(np.abs(errors).mean())
        sigma = found.calibration.sigma.camera.focal_px
        stated = f", σ(f_c) {100 * sigma[0] / 895.55:.2f} %" if sigma else ""
        print(
            f"  calibration, {name}: {means[name]:.3f} % ({', '.join(f'{error:+.2f}' for error in errors)}{stated}); "
            f"points {100 * cloud_error(matches, found, truth, calibration.baseline):.3f} % of their distance off"
        )
    return means


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4, 5])
    parser.add_argument("--camera", type=int, nargs=2, default=[1224, 1024])
    parser.add_argument("--projector", type=int, nargs=2, default=[854, 480])
    options = parser.parse_args()
    rooms = [run(seed, tuple(options.camera), tuple(options.projector)) for seed in options.seeds]
    for name, *_ in METHODS:
        values = [room[name] for room in rooms if name in room]
        if values:
            print(f"{name:8} mean {np.mean(values):.3f} %, worst {np.max(values):.3f} %, {len(values)} of {len(rooms)}")


if __name__ == "__main__":
    main()
