"""Beyond the paper: errors on random synthetic corners over what makes calibrating hard, with the Cramér–Rao bound."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cramer_rao import bound

from calib.geometry import Calibration
from calib.refinement import Knowledge
from calib.self_calibration import PrincipalPoint
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, CaptureOptions, SyntheticCapture, random_captures
from paper.captures import Setup, without_distortion
from paper.experiment import Experiment, Figures
from paper.methods import CENTRE_SIGMA_OF_WIDTH, by_paper, errors_of, known_point, refined

CORNERS, _QUICK_CORNERS = 16, 2
_SEED = 0
_CAMERA_SIZE, _PROJECTOR_SIZE = PAPER_CAMERA.size, PAPER_PROJECTOR.size
_CENTRE = PrincipalPoint(
    ((_CAMERA_SIZE[0] - 1) / 2, (_CAMERA_SIZE[1] - 1) / 2), CENTRE_SIGMA_OF_WIDTH * _CAMERA_SIZE[0]
)
_BASE = CaptureOptions(distance=(2.5, 2.5), baseline=(0.5, 0.5))
_MILD = (-0.02, -0.01)  # k1 of camera and projector
# Of a normal deviate the mean size is √(2/π) of its sigma: the bound as a mean error.
_MEAN_SIZE = float(np.sqrt(2 / np.pi))


@dataclass(frozen=True)
class Case:
    """A point of a curve. `area`: share of the picture that is used, around the vertex; `point_off_px`: how far the
    principal point that the methods are told is from the true one.
    """

    options: CaptureOptions = _BASE
    k1: tuple[float, float] = _MILD
    area: float = 1.0
    point_off_px: float = 0.0
    captures: int = 1
    point_known: bool = True


@dataclass(frozen=True)
class Curve:
    """`label` of the horizontal axis; `case` makes the point at each of `values`; `log`: of that axis.

    `corrected`: the paper's method is given matches of ideal lenses, as it assumes.
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
        outcomes = [_outcome(curve, case, number) for number in range(corners)]
        points.append({"at": value, "corners": corners} | _summary(outcomes))
        print(f"  {value:g}: {points[-1]}", flush=True)
    return {"points": points}


def _outcome(curve: Curve, case: Case, number: int) -> dict[str, float | None]:
    """Mean absolute error of the four intrinsics in per cent, by method; None for a refusal."""
    rng = np.random.default_rng([_SEED, number])
    camera, projector = (
        replace(device, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
        for device, k1 in zip((PAPER_CAMERA, PAPER_PROJECTOR), case.k1, strict=True)
    )
    captures = random_captures(rng, case.captures, case.options, camera=camera, projector=projector, same=False)
    captures = [_cut(capture, case.area) for capture in captures]
    truth, matches = captures[0].calibration, [capture.matches for capture in captures]
    told = _told(truth, case, rng)
    methods: dict[str, Callable[[], Calibration]] = {"refined": lambda: refined(matches, truth, told)}
    if case.point_off_px:
        # Per coordinate, of an error of that length in any direction.
        modest = replace(told, sigma_px=case.point_off_px / np.sqrt(2))
        methods["refined, told so"] = lambda: refined(matches, truth, modest)
    if case.captures == 1 and case.point_known:
        of_paper = without_distortion(matches[0], truth) if curve.corrected else matches[0]
        apparent = replace(truth, camera=replace(truth.camera, principal_point_px=told.px))
        methods["paper"] = lambda: by_paper(of_paper, apparent)
    errors = {name: _mean(errors_of(method, truth)) for name, method in methods.items()}
    sigma_px = case.point_off_px / np.sqrt(2) if case.point_known else told.sigma_px
    knowledge = Knowledge(_CAMERA_SIZE, _PROJECTOR_SIZE, told.px, sigma_px, 0.0)
    least = 100 * _MEAN_SIZE * float(bound(captures, knowledge, case.options.noise_px).mean())
    return errors | {"bound": least}


def _told(truth: Calibration, case: Case, rng: np.random.Generator) -> PrincipalPoint:
    if not case.point_known:
        return _CENTRE
    direction = rng.uniform(0, 2 * np.pi)
    x, y = truth.camera.principal_point_px
    off = case.point_off_px
    return replace(known_point(truth), px=(x + off * np.cos(direction), y + off * np.sin(direction)))


def _mean(errors: Iterable[float] | None) -> float | None:
    return None if errors is None else float(np.abs(np.array(list(errors))).mean())


def _cut(capture: SyntheticCapture, area: float) -> SyntheticCapture:
    """Only what falls into a part of the picture around the vertex, of the picture's shape."""
    if area == 1.0:
        return capture
    rig, matches = capture.calibration, capture.matches
    vertex = rig.projector.project(capture.corner.vertex @ rig.rotation.T + rig.translation)
    half = np.sqrt(area) * np.array(rig.projector.size) / 2
    # As far towards the vertex as the window stays in the picture.
    middle = np.clip(vertex, half, np.array(rig.projector.size) - half)
    inside = np.all(np.abs(matches.projector_px - middle) <= half, axis=1)
    return replace(capture, matches=matches[inside])


def _summary(outcomes: list[dict[str, float | None]]) -> Figures:
    """Medians over the corners, and how many were refused."""
    figures: Figures = {}
    for name in dict.fromkeys(name for outcome in outcomes for name in outcome):
        answers = [value for outcome in outcomes if (value := outcome.get(name)) is not None]
        figures[name] = float(np.median(answers)) if answers else None
        if name != "bound":
            figures[f"{name}: refused"] = len(outcomes) - len(answers)
    return figures


BEYOND = Experiment("beyond", lambda _: list(CURVES), _measure)
