"""Calibration of an unknown camera from photos of random corners: errors, and errors over sigmas.

    python benchmarks/bench_photos.py --corners 100 --seed 0

Synthetic matches: 2,000 of every further photo with the first, 0.3 px of noise in each photo, a principal point off the
centre by up to 15 % of the width, 0.3 of the distance between the photos. f is in per cent of the focal length, the
principal point (mean of both coordinates) in per cent of the width. 'error/σ' of 1 means that the sigma is true;
'bound' is the Cramér–Rao bound of one pair, its mean over the corners. 'cropped' shows a window of 'whole'. With
pycolmap, its two-view solution of the same matches is listed as well.
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import repeat

import numpy as np
from cramer_rao import bound_of_photos
from peer_photos import PEERS, two_view

from calib.geometry import Intrinsics, Matches
from calib.plane_segmentation import find_sparse_faces
from calib.refusal import RefusalError
from calib.self_calibration import calibrate_photos
from calib.synthetic import SyntheticPhotoOptions, SyntheticPhotos, random_photos

NOISE_PX = 0.3
WINDOW = (1120, 840)  # of a crop


@dataclass(frozen=True)
class Case:
    name: str
    options: SyntheticPhotoOptions = field(default_factory=SyntheticPhotoOptions)
    squareness_deg: float = 0.0
    crop: bool = False
    find_faces: bool = False
    peer: str = ""


WALLS = SyntheticPhotoOptions(walls_off_deg=0.3)
CASES = (
    Case("square"),
    Case("square, noise in the second photo only", SyntheticPhotoOptions(first_noise=False)),
    Case("square, k1 −0.05", SyntheticPhotoOptions(distortion=-0.05)),
    Case("square, faces found", find_faces=True),
    Case("square, whole", SyntheticPhotoOptions(shift=0.0)),
    Case("square, cropped", SyntheticPhotoOptions(shift=0.0), crop=True),
    Case("walls 0.3°", WALLS, 0.3),
    Case("walls 0.3°, 3 photos", replace(WALLS, photos=3), 0.3),
    Case("walls 0.3°, 4 photos", replace(WALLS, photos=4), 0.3),
    *(Case(f"pycolmap, {name}", peer=name) for name in PEERS),
)


@dataclass(frozen=True)
class Outcome:
    seconds: float
    error: np.ndarray | None = None
    deviation: np.ndarray | None = None
    bound: np.ndarray | None = None


def cropped(photos: SyntheticPhotos, rng: np.random.Generator) -> SyntheticPhotos:
    """The matches in a window of the photos, at a random place with matches of all faces."""
    camera = photos.camera
    for _ in range(1000):
        low = np.floor(rng.uniform((0, 0), (camera.width - WINDOW[0], camera.height - WINDOW[1])))
        centre = np.array(camera.principal_point_px) - low
        smaller = Intrinsics(*WINDOW, camera.focal_px, (float(centre[0]), float(centre[1])), camera.distortion)
        pairs = tuple(
            (_windowed(matches, low), replace(truth, camera=smaller, projector=smaller))
            for matches, truth in photos.pairs
        )
        if all(np.bincount(m.face, minlength=3).min() >= 0.1 * len(m) and len(m) > 400 for m, _ in pairs):
            return replace(photos, pairs=pairs)
    raise ValueError("no window shows all faces")


def _windowed(matches: Matches, low: np.ndarray) -> Matches:
    a, b = matches.camera_px - low, matches.projector_px - low
    inside = np.all((a >= 0) & (b >= 0) & (a < WINDOW) & (b < WINDOW), axis=1)
    return Matches(a[inside], b[inside], matches.face[inside])


def outcome(case: Case, seed: int, number: int) -> Outcome:
    rng = np.random.default_rng([seed, number])
    photos = random_photos(rng, case.options)
    if case.crop:
        # As many matches as in the whole photo, with the same noise, to measure the effect of the crop alone.
        photos = cropped(random_photos(np.random.default_rng([seed, number]), replace(case.options, count=4000)), rng)
    camera = photos.camera
    size = (camera.width, camera.height)
    truth = np.array([camera.focal_px[0], *camera.principal_point_px])
    scale = np.array([camera.focal_px[0], camera.width, camera.width])
    start = time.perf_counter()
    if case.peer:
        found = two_view(photos.pairs[0][0], size, case.peer)
        seconds = time.perf_counter() - start
        return Outcome(seconds) if found is None else Outcome(seconds, (found - truth) / scale)
    pairs = [matches for matches, _ in photos.pairs]
    try:
        if case.find_faces:
            pairs = [find_sparse_faces(replace(matches, face=None), size).matches for matches in pairs]
        calibration = calibrate_photos(pairs, size, squareness_deg=case.squareness_deg)[0].calibration
    except RefusalError as refusal:
        print(f"  {case.name}, corner {number}: refused: {refusal.reason[:150]}")
        return Outcome(time.perf_counter() - start)
    seconds = time.perf_counter() - start
    error = np.array([calibration.camera.focal_px[0], *calibration.camera.principal_point_px]) - truth
    sigma = np.array([calibration.sigma.camera.focal_px[0], *calibration.sigma.camera.principal_point_px])
    bound = None
    if len(pairs) == 1:
        noise = NOISE_PX if case.options.first_noise else 0.0
        bound = bound_of_photos(photos, case.squareness_deg, noise, NOISE_PX) / scale
    return Outcome(seconds, error / scale, error / sigma, bound)


def line(case: Case, outcomes: list[Outcome]) -> str:
    errors = np.array([each.error for each in outcomes if each.error is not None]).reshape(-1, 3)
    deviations = np.array([each.deviation for each in outcomes if each.deviation is not None]).reshape(-1, 3)
    bounds = np.array([each.bound for each in outcomes if each.bound is not None]).reshape(-1, 3)
    if not len(errors):
        return f"{case.name:40} no answer in {len(outcomes)}"
    size = np.abs(errors)
    # The mean absolute value of a normal deviate is √(2/π) of its sigma: the bound as a mean error.
    least = 100 * np.sqrt(2 / np.pi) * bounds.mean(axis=0) if len(bounds) else None
    return (
        f"{case.name:40} {100 * size[:, 0].mean():8.3f} {100 * np.median(size[:, 0]):8.3f}"
        + (f"{least[0]:8.3f}" if least is not None else f"{'–':>8}")
        + f" {100 * size[:, 1:].mean():9.3f} {100 * np.median(size[:, 1:]):8.3f}"
        + (f"{least[1:].mean():8.3f}" if least is not None else f"{'–':>8}")
        + (
            f" {np.sqrt(np.mean(deviations[:, 0] ** 2)):8.2f}{np.sqrt(np.mean(deviations[:, 1:] ** 2)):7.2f}"
            if len(deviations)
            else f" {'–':>8}{'–':>7}"
        )
        + f"{len(outcomes) - len(errors):6d}/{len(outcomes):<4d}{np.median([each.seconds for each in outcomes]):6.2f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--corners", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--processes", type=int, default=None)
    options = parser.parse_args()
    print(
        f"{'':40} {'f, %: mean':>10} median   bound  {'PP, %: mean':>9} median  bound  error/σ: f   PP  refused    time"
    )
    with ProcessPoolExecutor(options.processes) as pool:
        for case in CASES:
            if options.only in case.name:
                runs = pool.map(outcome, repeat(case), repeat(options.seed), range(options.corners))
                print(line(case, list(runs)), flush=True)


if __name__ == "__main__":
    main()
