"""Between captures of one corner: how sure the calibration is by now, where to go next, and when it is enough."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnostics import FROM_ONE_PLACE, WORTH_A_CAPTURE, NextView
from calib.finding import of_kinds
from calib.geometry import Calibration
from calib.pointcloud import build_cloud
from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.quantities import METRES, percent, relative_focal_sigmas
from scanner.reconstruction.calibrate import calibrate, label
from scanner.reconstruction.merge_clouds import overlap
from scanner.results import MEASUREMENT_GRADE, Decoded, SelfCalibrated

_LITTLE_OVERLAP = 0.1
_NOT_A_STEP = 0.05  # share of the longest component of the step


@dataclass(frozen=True)
class Guidance:
    """Advice to an operator after some captures; `enough`: a further one is not needed for a measurement."""

    sentences: tuple[str, ...]
    enough: bool


def guide(captures: Sequence[Decoded], config: Config) -> tuple[Guidance, list[Decoded]]:
    """Return advice from the captures so far, and the captures with the faces found in them."""
    try:
        labelled = label(captures, [*captures], config)
    except RefusalError as refusal:
        return _refused(refusal), [*captures]
    try:
        return _of(calibrate(labelled, config)), labelled
    except RefusalError as refusal:
        return _refused(refusal), labelled


def _refused(refusal: RefusalError) -> Guidance:
    return Guidance(tuple(filter(None, (f"Not enough to calibrate yet: {refusal.reason}", refusal.advice))), False)


def _of(calibrated: Sequence[SelfCalibrated]) -> Guidance:
    newest = calibrated[-1]
    sigmas = relative_focal_sigmas(newest.calibration)
    enough = len(sigmas) == 2 and max(sigmas.values()) <= MEASUREMENT_GRADE
    known = " and ".join(f"{100 * sigma:.2g} % ({device})" for device, sigma in sigmas.items())
    sentences = [f"So far the focal lengths are known to {known}." if known else "The uncertainty is unknown."]
    sentences += map(str, of_kinds(newest.solution.findings, FROM_ONE_PLACE))
    if len(calibrated) > 1:
        sentences.append(_on_overlap(calibrated))
    return Guidance((*sentences, *_what_next(newest, sigmas.get("camera"), enough=enough)), enough)


def _on_overlap(calibrated: Sequence[SelfCalibrated]) -> str:
    clouds = [
        build_cloud(capture.decoded.matches, capture.decoded.texture, capture.calibration) for capture in calibrated
    ]
    share = overlap(calibrated, clouds)
    if share is None:
        return "Whether it shows what was seen before is unclear: the corner looks alike from several sides."
    little = " That is little overlap for merging the clouds." if share < _LITTLE_OVERLAP else ""
    return f"{percent(share)} of what it shows was seen before.{little}"


def _what_next(newest: SelfCalibrated, sigma: float | None, *, enough: bool) -> Iterator[str]:
    view = newest.solution.next_view
    worth = view is not None and sigma is not None and view.sigma <= WORTH_A_CAPTURE * sigma
    if enough:
        yield "That is enough to measure." + ("" if worth else " A further capture would gain little.")
    elif not worth:
        yield ("No single further capture would gain much: capture from where the faces show at different slants.")
    if worth and view is not None and sigma is not None:
        yield (
            f"Next: {where_to(view, newest.calibration)}. The sigma of the camera's focal length would fall from "
            f"{100 * sigma:.2g} % to about {100 * view.sigma:.2g} %."
        )


def where_to(view: NextView, calibration: Calibration) -> str:
    """Directions to the next view for the operator: a step, as the camera sees it, and a rotation."""
    right, down, forward = calibration.baseline * view.step
    least = _NOT_A_STEP * float(np.abs(view.step).max()) * calibration.baseline
    steps = [
        f"{_length(abs(size), calibration.unit)} {ways[bool(size < 0)]}"
        for size, ways in (
            (right, ("to the right", "to the left")),
            (-down, ("up", "down")),
            (forward, ("forward", "back")),
        )
        if abs(size) > least
    ]
    turns = [
        f"{abs(angle):.0f}° {ways[angle < 0]}"
        for angle, ways in ((view.right_deg, ("to the left", "to the right")), (view.up_deg, ("down", "up")))
        if angle
    ]
    return (
        f"move the rig {_listed(steps)} as the camera sees it, and turn it {_listed(turns)}, so that the corner stays "
        "where it is in the picture"
    )


def _listed(parts: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1])))


def _length(value: float, unit: str) -> str:
    if unit not in METRES:
        return f"{value:.2g} × the distance between camera and projector"
    metres = value * METRES[unit]
    return f"{metres:.2g} m" if metres >= 0.1 else f"{1000 * metres:.2g} mm"
