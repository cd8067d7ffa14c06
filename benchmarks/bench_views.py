"""Acceptance and refusal of random views, ordinary and degenerate, over the whole range of rigs.

    python benchmarks/bench_views.py --views 500 --seed 0

A view is accepted with its sigmas or refused with a reason. The table counts accepted views with a focal length or
projector principal point off by more than 5 sigma, and refused views whose focal lengths have a Cramér–Rao bound below
1 %. Synthetic matches, no images; corner 1.5 to 6 m away, baseline 0.15 to 0.8 m, any roll, focals of 0.5 to
3 widths, projector shifted by up to half its height, noise 0.03 to 0.5 px, 300 to 100,000 matches.
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np
from cramer_rao import bound

from calib.geometry import Calibration, Intrinsics, Matches
from calib.refinement import Knowledge
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, self_calibrate
from calib.synthetic import CaptureOptions, SyntheticCapture, random_capture

CAMERA_SIZE, PROJECTOR_SIZE = (2448, 2048), (854, 480)
WRONG_SIGMAS, USEFUL_SIGMA = 5.0, 0.01


@dataclass(frozen=True)
class View:
    """A capture, and the knowledge given to the program; `impossible` if it cannot be calibrated by design."""

    kind: str
    capture: SyntheticCapture
    principal_point: PrincipalPoint
    squareness_deg: float
    noise_px: float
    impossible: bool = False


def random_options(rng: np.random.Generator) -> CaptureOptions:
    """A rig and a room from the whole range."""
    width, height = CAMERA_SIZE
    camera_centre = ((width - 1) / 2 + 0.02 * width * rng.normal(), (height - 1) / 2 + 0.02 * width * rng.normal())
    shift = rng.uniform(-0.5, 0.5) * PROJECTOR_SIZE[1]
    projector_centre = (426.5 + rng.normal(0, 10), 239.5 + shift)
    # Fields of view are chosen together: a wide projector with a long camera lens lights what is not seen.
    field = np.exp(rng.uniform(np.log(0.5), np.log(3.0)))
    other = np.clip(field * np.exp(rng.uniform(-0.5, 0.5)), 0.5, 3.0)
    strength = rng.choice([0.0, 0.02, 0.06]) * min(1.0, field) ** 2
    return CaptureOptions(
        camera=Intrinsics(*CAMERA_SIZE, (field * width,) * 2, camera_centre, (-strength, 0.0, 0.0, 0.0, 0.0)),
        projector=Intrinsics(
            *PROJECTOR_SIZE, (other * PROJECTOR_SIZE[0],) * 2, projector_centre, (-strength / 2, 0.0, 0.0, 0.0, 0.0)
        ),
        count=int(np.exp(rng.uniform(np.log(300), np.log(100_000)))),
        noise_px=float(np.exp(rng.uniform(np.log(0.03), np.log(0.5)))),
        distance=(1.5, 6.0),
        baseline=(0.15, 0.8),
        roll=float(rng.choice([0.1, 1.5])),
        walls_off_deg=float(rng.choice([0.0, 0.3])),
        least_share=0.06,
    )


def _drawn(rng: np.random.Generator, kind: str) -> tuple[CaptureOptions, SyntheticCapture]:
    """Draw rigs until both devices see the corner."""
    while True:
        options = _changed(rng, kind, random_options(rng))
        for _ in range(20):
            try:
                return options, random_capture(rng, options, attempts=1)
            except ValueError:
                continue


def _changed(rng: np.random.Generator, kind: str, options: CaptureOptions) -> CaptureOptions:
    axis = rng.integers(3)
    if kind == "face seen at a slant":
        slants = [(0.25, 1.0)] * 3
        slants[axis] = (0.01, 0.12)
        return replace(options, slants=tuple(slants), least_share=0.005)
    if kind == "small face":
        return replace(options, least_share=0.001, distance=(4.0, 6.0), baseline=(0.15, 0.4))
    if kind == "forward":
        return replace(options, forward=float(rng.uniform(0.0, 0.15)))
    if kind == "short baseline":
        return replace(options, baseline=(0.01, 0.08))
    if kind == "walls at 83°":
        return replace(options, walls_off_deg=7.0)
    if kind == "parallel faces":
        return replace(options, parallel_m=float(rng.uniform(0.2, 0.8)), least_share=0.03)
    return options


def random_view(rng: np.random.Generator, kind: str) -> View:
    options, capture = _drawn(rng, kind)
    known = bool(rng.random() < 0.6)
    centre = ((CAMERA_SIZE[0] - 1) / 2, (CAMERA_SIZE[1] - 1) / 2)
    point = PrincipalPoint(options.camera.principal_point_px, 0.0) if known else PrincipalPoint(centre, 73.0)
    matches = capture.matches
    face = matches.face
    assert face is not None
    if kind == "one plane":
        matches = _split(matches.on_face(int(np.bincount(face).argmax())), (0, 1, 2))
    elif kind == "two planes":
        first, second = np.argsort(-np.bincount(face, minlength=3))[:2]
        halves, rest = _split(matches.on_face(int(first)), (0, 1)), matches.on_face(int(second))
        matches = _joined(halves, rest.with_faces(np.full(len(rest), 2, np.int32)))
    return View(
        kind,
        replace(capture, matches=matches),
        point,
        0.3 if options.walls_off_deg else 0.0,
        options.noise_px,
        kind in ("one plane", "two planes", "walls at 83°", "parallel faces"),
    )


def _split(plane: Matches, labels: tuple[int, ...]) -> Matches:
    """One plane cut into strips with different face labels."""
    x = plane.camera_px[:, 0]
    inner = np.quantile(x, np.linspace(0, 1, len(labels) + 1)[1:-1])
    return plane.with_faces(np.array(labels, np.int32)[np.digitize(x, inner)])


def _joined(a: Matches, b: Matches) -> Matches:
    assert a.face is not None
    assert b.face is not None
    return Matches(
        np.concatenate([a.camera_px, b.camera_px]),
        np.concatenate([a.projector_px, b.projector_px]),
        np.concatenate([a.face, b.face]),
    )


def best_sigma(view: View) -> float:
    """The larger relative sigma of the focal lengths by the Cramér–Rao bound."""
    point = view.principal_point
    knowledge = Knowledge(CAMERA_SIZE, PROJECTOR_SIZE, point.px, point.sigma_px, view.squareness_deg)
    return float(max(bound([view.capture], knowledge, view.noise_px)[:2]))


def deviations(found: Calibration, truth: Calibration) -> np.ndarray:
    """Errors of (f_c, f_p, x_p, y_p) in their sigmas."""
    values = [found.camera.focal_px[0], found.projector.focal_px[0], *found.projector.principal_point_px]
    true = [truth.camera.focal_px[0], truth.projector.focal_px[0], *truth.projector.principal_point_px]
    sigma = found.sigma
    sigmas = [sigma.camera.focal_px[0], sigma.projector.focal_px[0], *sigma.projector.principal_point_px]
    off: np.ndarray = (np.array(values) - true) / np.array(sigmas)
    return off


KINDS = {
    "ordinary": 0.55,
    "face seen at a slant": 0.08,
    "small face": 0.06,
    "forward": 0.06,
    "short baseline": 0.05,
    "walls at 83°": 0.05,
    "parallel faces": 0.05,
    "one plane": 0.05,
    "two planes": 0.05,
}


@dataclass(frozen=True)
class Outcome:
    """The outcome of a view: `deviation` (4,) in sigmas if accepted; `needless` refusals; a `line` to print."""

    kind: str
    deviation: np.ndarray | None = None
    needless: bool = False
    line: str = ""

    @property
    def wrong(self) -> bool:
        return self.deviation is not None and bool(np.abs(self.deviation).max() > WRONG_SIGMAS)


def outcome(seed: int, number: int, kind: str | None) -> Outcome:
    rng = np.random.default_rng([seed, number])
    kind = kind or str(rng.choice(list(KINDS), p=list(KINDS.values())))
    view = random_view(rng, kind)
    title = f"{number}: {kind}, {len(view.capture.matches)} matches, noise {view.noise_px:.2f} px"
    try:
        found = self_calibrate(
            view.capture.matches,
            CAMERA_SIZE,
            PROJECTOR_SIZE,
            principal_point=view.principal_point,
            squareness_deg=view.squareness_deg,
        ).calibration
    except RefusalError as refusal:
        best = np.inf if view.impossible else best_sigma(view)
        return Outcome(kind, None, best < USEFUL_SIGMA, f"{title}, σ ≥ {100 * best:.2f} %: {refusal}")
    truth = view.capture.calibration
    deviation = deviations(found, truth)
    focals = f"f {truth.camera.focal_px[0]:.0f}, found {found.camera.focal_px[0]:.0f} px"
    return Outcome(kind, deviation, line=f"{title}: errors {deviation.round(1)} σ, {focals}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, default=None)
    parser.add_argument("--verbose", action="store_true", help="print each wrong answer and each needless refusal")
    options = parser.parse_args()
    start = time.perf_counter()
    outcomes = []
    with ProcessPoolExecutor() as pool:
        for each in pool.map(outcome, repeat(options.seed), range(options.views), repeat(options.kind)):
            outcomes.append(each)
            if options.verbose and (each.wrong or each.needless):
                print(each.line, flush=True)
    print(f"{'kind':22} {'accepted':>8} {'wrong':>6} {'refused':>8} {'needlessly':>10} {'rms err/σ':>10}")
    for kind in KINDS:
        _show(kind, [each for each in outcomes if each.kind == kind])
    _show("all", outcomes)
    accepted = sum(each.deviation is not None for each in outcomes)
    print(
        f"wrong by more than {WRONG_SIGMAS:g} sigma: "
        f"{100 * sum(each.wrong for each in outcomes) / max(accepted, 1):.2f} % of the accepted; refused though sigma "
        f"< 1 %: {100 * sum(each.needless for each in outcomes) / len(outcomes):.2f} % of all; "
        f"{time.perf_counter() - start:.0f} s"
    )


def _show(kind: str, outcomes: list[Outcome]) -> None:
    deviations = [each.deviation for each in outcomes if each.deviation is not None]
    rms = f"{np.sqrt(np.mean(np.square(deviations))):10.2f}" if deviations else f"{'–':>10}"
    wrong, needless = sum(each.wrong for each in outcomes), sum(each.needless for each in outcomes)
    print(f"{kind:22} {len(deviations):8d} {wrong:6d} {len(outcomes) - len(deviations):8d} {needless:10d} {rms}")


if __name__ == "__main__":
    main()
