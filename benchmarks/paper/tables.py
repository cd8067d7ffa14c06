"""The paper's tables 1 to 3, measured in each room."""

from functools import partial

import numpy as np

from calib.geometry import Calibration, Matches
from paper.captures import QUICK, Setup, captured, thinned, without_distortion
from paper.colmap import MATCHES as MATCHES_FOR_COLMAP
from paper.colmap import VIEWS, centre_start, drawn_start, focal_error_percent, paper_start, variants, with_known_points
from paper.experiment import Experiment, Figures, room_of, rooms
from paper.methods import (
    ORDINARY_WALLS_DEG,
    Errors,
    by_configurations,
    by_paper,
    errors_of,
    known_point,
    refined,
    refined_knowing,
    unknown_point,
)
from paper.page_tables import BOTH_POINTS
from paper.published import DOWNSAMPLED, MATCHES
from scanner.quantities import intrinsic_errors_percent

_DRAWS, _QUICK_DRAWS = 5, 1


def _own_methods(setup: Setup, part: str) -> Figures:
    room = room_of(part)
    first, second = (captured(setup, room, pose) for pose in (0, 1))
    truth, masked = first.truth, first.with_true_faces
    known, unknown = known_point(truth), unknown_point(setup)
    methods = {
        "paper, true faces": lambda: by_paper(masked, truth),
        "paper, automatic faces": lambda: by_paper(first.matches, truth),
        "paper, true faces, lenses corrected": lambda: by_paper(without_distortion(masked, truth), truth),
        "refined, PP known": lambda: refined([first.matches], truth, known),
        "refined, PP unknown": lambda: refined([first.matches], truth, unknown),
        "refined, PP and walls unknown": lambda: refined([first.matches], truth, unknown, ORDINARY_WALLS_DEG),
        "refined, two captures, PP unknown": lambda: refined([first.matches, second.matches], truth, unknown),
    }
    return {"matches": len(first.matches)} | {name: errors_of(method, truth) for name, method in methods.items()}


def _two_views(setup: Setup, part: str) -> Figures:
    room = room_of(part)
    capture = captured(setup, room)
    truth = capture.truth
    matches = thinned(capture.with_true_faces, MATCHES_FOR_COLMAP, room)
    corrected = without_distortion(matches, truth)
    rng = np.random.default_rng(room)
    figures: Figures = {"matches": len(matches)}
    for start, start_px in (("C", centre_start(truth)), ("R", paper_start(truth))):
        figures |= _both(start, matches, truth, start_px)
        figures |= _both(f"{start}, lenses corrected", corrected, truth, start_px)
    draws = [drawn_start(truth, rng) for _ in range(_QUICK_DRAWS if setup.quick else _DRAWS)]
    walls = {"": 0.0, ", walls unknown": ORDINARY_WALLS_DEG}
    figures[BOTH_POINTS] = {
        f"COLMAP{name}": _errors(with_known_points(corrected, truth, from_truth=bool(name)), truth)
        for name in ("", ", true start")
    } | {
        f"refined{name}": errors_of(partial(refined_knowing, corrected, truth, off_deg), truth)
        for name, off_deg in walls.items()
    }
    figures["R, further draws"] = [_both("R", matches, truth, start_px) for start_px in draws]
    return figures


def _both(start: str, matches: Matches, truth: Calibration, start_px: tuple[float, float]) -> dict[str, Errors]:
    held, freed = variants(matches, truth, start_px)
    name, _, rest = start.partition(",")
    ba = f"{name}-BA,{rest}" if rest else f"{name}-BA"
    return {start: _errors(held, truth), ba: _errors(freed, truth)}


def _errors(found: Calibration | None, truth: Calibration) -> Errors:
    return None if found is None else [float(error) for error in intrinsic_errors_percent(found, truth)]


def _many_views(setup: Setup, part: str) -> Figures:
    # At full size, twenty views cost an hour per room, and the remaining error is negligible.
    size, count = QUICK, VIEWS // 2 if setup.quick else VIEWS
    found = focal_error_percent(room_of(part), size, count)
    error, placed = (None, 0) if found is None else found
    return {"size": list(size), "views": count, "placed": placed, "f_c": error}


def _objectives(setup: Setup, part: str) -> Figures:
    capture = captured(setup, room_of(part))
    masked, truth = capture.with_true_faces, capture.truth
    return {
        "as decoded": by_configurations(masked, truth),
        "lenses corrected": by_configurations(without_distortion(masked, truth), truth),
    }


def _downsampled(setup: Setup, part: str) -> Figures:
    room = room_of(part)
    capture = captured(setup, room)
    truth = capture.truth
    all_of_them = thinned(capture.with_true_faces, MATCHES, room)
    figures: Figures = {}
    for rate in DOWNSAMPLED:
        some = thinned(all_of_them, len(all_of_them) // rate, room)
        corrected = without_distortion(some, truth)
        figures[str(rate)] = {
            "matches": len(some),
            "paper": errors_of(partial(by_paper, some, truth), truth),
            "paper, lenses corrected": errors_of(partial(by_paper, corrected, truth), truth),
            "refined": errors_of(partial(refined, [some], truth, known_point(truth)), truth),
        }
    return figures


TABLES = (
    Experiment("table1", rooms, _own_methods),
    Experiment("table1-two-views", rooms, _two_views, needs_colmap=True),
    Experiment("table1-many-views", rooms, _many_views, needs_colmap=True),
    Experiment("table2", rooms, _objectives),
    Experiment("table3", rooms, _downsampled),
)
