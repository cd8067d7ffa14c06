"""Beyond the paper: errors on random synthetic corners over the difficulty, with the Cramér–Rao bound."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cramer_rao import bound_covariance

from calib.geometry import Calibration
from calib.refinement import Knowledge
from calib.self_calibration import PrincipalPoint
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, CaptureOptions, SyntheticCapture, random_captures
from paper.captures import Setup, without_distortion
from paper.experiment import Experiment, Figures
from paper.markdown import mean_size
from paper.methods import CENTRE_SIGMA_OF_WIDTH, by_paper, errors_of, known_point, refined

CORNERS, _QUICK_CORNERS = 16, 2
_SEED = 0
_CAMERA_SIZE, _PROJECTOR_SIZE = PAPER_CAMERA.size, PAPER_PROJECTOR.size
_CENTRE = PrincipalPoint(
    ((_CAMERA_SIZE[0] - 1) / 2, (_CAMERA_SIZE[1] - 1) / 2), CENTRE_SIGMA_OF_WIDTH * _CAMERA_SIZE[0]
)
_BASE = CaptureOptions(distance=(2.5, 2.5), baseline=(0.5, 0.5))
_MILD = (-0.02, -0.01)  # k1 of camera and projector
_DRAWS = 1000  # random errors with the covariance of the bound


@dataclass(frozen=True)
class Case:
    """A point of a curve. `area`: share of the picture that is used, around the vertex.

    `point_off_px`: error of the principal point given to the methods. `off_deg`: standard deviation of the angles
    between the walls, which the refined method knows.
    """

    options: CaptureOptions = _BASE
    k1: tuple[float, float] = _MILD
    area: float = 1.0
    point_off_px: float = 0.0
    captures: int = 1
    point_known: bool = True
    off_deg: float = 0.0


@dataclass(frozen=True)
class Curve:
    """`label` of the horizontal axis; `case` gives the point at each of `values`; `log`: a logarithmic axis.

    `corrected`: the paper's method gets matches of ideal lenses, as it assumes.
    """

    label: str
    values: tuple[float, ...]
    case: Callable[[Any], Case]
    log: bool = True
    corrected: bool = True


def _with(**changes: Any) -> Case:
    return Case(replace(_BASE, **changes))


CURVES = {
    "noise": Curve("noise of a match (projector px)", (0.02, 0.05, 0.1, 0.2, 0.5, 1.0), lambda x: _with(noise_px=x)),
    "baseline": Curve(
        "baseline (m), the corner 2.5 m away", (0.1, 0.2, 0.4, 0.8, 1.6), lambda x: _with(baseline=(x, x))
    ),
    "distance": Curve("distance (m), the baseline 0.5 m", (1.0, 2.0, 4.0, 8.0), lambda x: _with(distance=(x, x))),
    "visible area": Curve(
        "share of the picture that falls on the corner", (0.03, 0.1, 0.25, 0.5, 1.0), lambda x: Case(area=x)
    ),
    "lens distortion": Curve(
        "−k₁ of the camera; the projector has half",
        (0.0, 0.01, 0.02, 0.05, 0.1),
        lambda x: Case(k1=(-x, -x / 2)),
        log=False,
        corrected=False,
    ),
    "principal point": Curve(
        "error of the principal point that is given (px)",
        (0.0, 2.0, 5.0, 10.0, 20.0, 40.0),
        lambda x: Case(point_off_px=x),
        log=False,
    ),
    "walls": Curve(
        "standard deviation of the walls' angles from 90° (°)",
        (0.0, 0.03, 0.1, 0.3, 1.0),
        lambda x: Case(replace(_BASE, walls_off_deg=x), off_deg=x),
        log=False,
    ),
    "captures": Curve(
        "captures of different corners, principal point unknown",
        (1, 2, 3, 4, 6),
        lambda x: Case(captures=int(x), point_known=False),
        log=False,
    ),
}


def _measure(setup: Setup, part: str) -> Figures:
    curve = CURVES[part]
    corners = _QUICK_CORNERS if setup.quick else CORNERS
    points = []
    for value in curve.values:
        case = curve.case(value)
        drawn = [_draw(case, number) for number in range(corners)]
        outcomes = [_outcome(curve, case, each) for each in drawn]
        least = float(np.median([_least_errors(case, each) for each in drawn]))
        points.append({"at": value, "corners": corners, "bound": least} | _summary(outcomes))
        print(f"  {value:g}: {points[-1]}", flush=True)
    return {"points": points}


@dataclass(frozen=True)
class Drawn:
    """A corner's captures, and the principal point given to the methods."""

    captures: list[SyntheticCapture]
    told: PrincipalPoint


def _draw(case: Case, number: int) -> Drawn:
    rng = np.random.default_rng([_SEED, number])
    camera, projector = (
        replace(device, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
        for device, k1 in zip((PAPER_CAMERA, PAPER_PROJECTOR), case.k1, strict=True)
    )
    captures = random_captures(rng, case.captures, case.options, camera=camera, projector=projector, same=False)
    captures = [_cut(capture, case.area) for capture in captures]
    return Drawn(captures, _told(captures[0].calibration, case, rng))


def _told(truth: Calibration, case: Case, rng: np.random.Generator) -> PrincipalPoint:
    if not case.point_known:
        return _CENTRE
    direction = rng.uniform(0, 2 * np.pi)
    x, y = truth.camera.principal_point_px
    off = case.point_off_px
    return replace(known_point(truth), px=(x + off * np.cos(direction), y + off * np.sin(direction)))


def _doubted(case: Case, told: PrincipalPoint) -> PrincipalPoint:
    """With a sigma of each coordinate, for an error of this length in any direction."""
    return replace(told, sigma_px=case.point_off_px / np.sqrt(2)) if case.point_known else told


def _outcome(curve: Curve, case: Case, drawn: Drawn) -> dict[str, float | None]:
    """Mean absolute error of the four intrinsics in per cent, by method; None for a refusal."""
    truth, matches = drawn.captures[0].calibration, [capture.matches for capture in drawn.captures]
    told = drawn.told
    methods: dict[str, Callable[[], Calibration]] = {"refined": lambda: refined(matches, truth, told, case.off_deg)}
    if case.point_off_px:
        methods["refined, told so"] = lambda: refined(matches, truth, _doubted(case, told))
    if case.captures == 1 and case.point_known:
        of_paper = without_distortion(matches[0], truth) if curve.corrected else matches[0]
        apparent = replace(truth, camera=replace(truth.camera, principal_point_px=told.px))
        methods["paper"] = lambda: by_paper(of_paper, apparent)
    return {name: mean_size(errors_of(method, truth)) for name, method in methods.items()}


def _least_errors(case: Case, drawn: Drawn) -> np.ndarray:
    """Mean absolute errors (draws,) in per cent of an estimate at the Cramér–Rao bound."""
    point = _doubted(case, drawn.told)
    knowledge = Knowledge(_CAMERA_SIZE, _PROJECTOR_SIZE, point.px, point.sigma_px, case.off_deg)
    covariance = bound_covariance(drawn.captures, knowledge, case.options.noise_px)
    errors = np.random.default_rng(_SEED).multivariate_normal(np.zeros(4), covariance, _DRAWS)
    return np.asarray(100 * np.abs(errors).mean(axis=1))


def _cut(capture: SyntheticCapture, area: float) -> SyntheticCapture:
    """The matches in a part of the picture around the vertex, of the same aspect."""
    if area == 1.0:
        return capture
    rig, matches = capture.calibration, capture.matches
    vertex = rig.projector.project(rig.pose @ capture.corner.vertex)
    half = np.sqrt(area) * np.array(rig.projector.size) / 2
    # As close to the vertex as the window stays in the picture.
    middle = np.clip(vertex, half, np.array(rig.projector.size) - half)
    inside = np.all(np.abs(matches.projector_px - middle) <= half, axis=1)
    return replace(capture, matches=matches[inside])


def _summary(outcomes: list[dict[str, float | None]]) -> Figures:
    """Medians over the corners, and the number of refusals."""
    figures: Figures = {}
    for name in dict.fromkeys(name for outcome in outcomes for name in outcome):
        answers = [value for outcome in outcomes if (value := outcome.get(name)) is not None]
        figures[name] = float(np.median(answers)) if answers else None
        figures[f"{name}: refused"] = len(outcomes) - len(answers)
    return figures


BEYOND = Experiment("beyond", lambda _: list(CURVES), _measure)
