"""Errors over sigmas of single captures of furnished rooms, from frames to calibration.

    python benchmarks/bench_furnished.py [--rooms 50] [--seed 100] [--jobs 2]

The furniture is rotated about the vertical by N(0, 2°), all light transport is on; camera of 612 × 512 pixels,
projector of 427 × 240, walls square, the camera's principal point known, and unknown. 'error/sigma': root mean square
over the rooms of each of the rig's parameters; the last line excludes the decoder's smooth errors (`SMOOTH_PX`).
'modes': root mean square of the polynomials in the matches' errors over a face, constant first, from which that value
comes; 'noise': what independent matches would give.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from bench_bias import CAMERA, PROJECTOR, decoded, room_of
from conditions.captures import patterns_of, take
from rig_deviation import COLUMNS, deviations, rms_of_columns

from calib.estimation import Shifts
from calib.geometry import Calibration, Matches
from calib.numerics import Floats, orthonormal_polynomials
from calib.plane_segmentation import find_faces
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, self_calibrate
from hw.settings import SimulatedRigSettings
from hw.simulated import GroundTruth
from scanner.decoding import SMOOTH_PX

OUTLYING = 5.0
CASES = (("known", SMOOTH_PX), ("unknown", SMOOTH_PX), ("known", 0.0))


@dataclass
class Outcome:
    """One room: deviations of the rig's columns in sigmas for each case, None if refused; `modes` (3, modes, 2) and
    `noise_px` of the faces.
    """

    modes: Floats
    noise_px: Floats
    cases: list[Floats | None] = field(default_factory=list)


def point_of(name: str, truth: Calibration) -> PrincipalPoint:
    if name == "known":
        return PrincipalPoint(truth.camera.principal_point_px, 0.0)
    return PrincipalPoint(((CAMERA[0] - 1) / 2, (CAMERA[1] - 1) / 2), 0.03 * CAMERA[0])


def modes_of(matches: Matches, truth: GroundTruth) -> tuple[Floats, Floats]:
    """Amplitudes (3, modes, 2) of polynomials in the errors over each face, and the contribution of noise, (3,)."""
    assert matches.sigma_px is not None
    x, y = np.rint(matches.camera_px).astype(int).T
    error = matches.projector_px - truth.projector_px[y, x]
    near = np.linalg.norm(error, axis=1) < OUTLYING * matches.sigma_px
    modes, noise = [], []
    for face in range(3):
        of = np.flatnonzero(near & (matches.labels == face))
        weight = 1 / matches.sigma_px[of].astype(np.float64)
        weight /= np.sqrt(np.mean(weight**2))
        orthonormal = orthonormal_polynomials(matches.camera_px[of], weight)
        modes.append(orthonormal.T @ (error[of] * weight[:, None]) / np.sqrt(len(of)))
        noise.append(1 / np.sqrt(np.sum(1 / matches.sigma_px[of].astype(np.float64) ** 2)))
    return np.stack(modes), np.array(noise)


def outcome(seed: int) -> Outcome:
    room = room_of(SimulatedRigSettings(seed=seed, furniture_askew_deg=2.0), None)
    truth = room.calibration
    assert truth is not None
    faces = find_faces(decoded(take(room, patterns_of("standard", PROJECTOR), 1.0)), CAMERA, PROJECTOR)
    found = Outcome(*modes_of(faces.matches, room.ground_truth()))
    for name, smooth_px in CASES:
        try:
            calibrated = self_calibrate(
                faces.matches,
                CAMERA,
                PROJECTOR,
                principal_point=point_of(name, truth),
                squareness_deg=0.0,
                plane=faces.plane,
                shifts=Shifts(smooth_px=smooth_px),
            )
            found.cases.append(deviations(calibrated, truth))
        except RefusalError as refusal:
            print(f"room {seed}, principal point {name}: refused. {refusal}")
            found.cases.append(None)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=50)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        rooms = list(pool.map(outcome, range(options.seed, options.seed + options.rooms)))
    print(f"{'error/sigma, rms':44} four  {' '.join(f'{name:>5}' for name in COLUMNS)}")
    for number, (name, smooth_px) in enumerate(CASES):
        answered = [found for room in rooms if (found := room.cases[number]) is not None]
        words = f"principal point {name}, smooth {smooth_px:g} px, {len(answered)} of {len(rooms)}"
        print(f"{words:44} {rms_of_columns(np.stack(answered))}")
    amplitudes = np.sqrt(np.mean(np.square([room.modes for room in rooms]), axis=(0, 1, 3)))
    noise = np.sqrt(np.mean(np.square([room.noise_px for room in rooms])))
    print(f"modes, px: {' '.join(f'{amplitude:.5f}' for amplitude in amplitudes)}; noise {noise:.5f}")


if __name__ == "__main__":
    main()
