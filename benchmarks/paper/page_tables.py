"""Tables 1 to 3 on the page."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from paper import published
from paper.experiment import Figures
from paper.markdown import NONE, answered, mean_of, mean_size, method_name, number, table
from paper.plots import Axis, curves

Parts = dict[str, Figures]
Pictures = dict[str, str]
# What the page calls a method, its key in the results, and its key among the paper's own figures.
OWN_METHODS = (
    ("the paper's method, true faces", "paper, true faces", "paper"),
    ("the paper's method, automatic faces", "paper, automatic faces", "paper"),
    ("the paper's method, true faces, lenses corrected", "paper, true faces, lenses corrected", "paper"),
    ("**refined**, PP known", "refined, PP known", ""),
    ("**refined**, PP unknown", "refined, PP unknown", ""),
    ("**refined**, PP unknown, walls square to ± 0.3° only", "refined, PP and walls unknown", ""),
    ("**refined**, two captures jointly, PP unknown", "refined, two captures, PP unknown", ""),
)
STARTS = ("C", "C-BA", "R", "R-BA")  # of COLMAP's two views
LENSES_CORRECTED = ", lenses corrected"
BOTH_POINTS = "both PP known, lenses corrected"
KNOWING = (
    ("COLMAP, two views", "COLMAP"),
    ("COLMAP, two views, from the true focal lengths", "COLMAP, true start"),
    ("**refined**", "refined"),
    ("**refined**, walls square to ± 0.3° only", "refined, walls unknown"),
)


def table_1(own: Parts, many_views: Parts) -> str:
    """Mean absolute errors of each method. The signed errors of each room are in `results/table1*.json`."""
    rooms = sorted(own)
    rows = [_method_row(own, rooms, *method) for method in OWN_METHODS]
    rows += [_many_views_row(many_views)] if many_views else []
    quoted = f"{published.MEAN_ERRORS['DroidCalib, 20 views']}"
    rows.append(["DroidCalib, 20 views (f_c only; needs weights and a GPU: quoted)", NONE, NONE, NONE, quoted])
    return table(["error, %", "mean", "worst room", "f_c alone, mean", "the paper's own figure"], rows)


def _method_row(parts: Parts, rooms: Sequence[str], shown: str, key: str, in_paper: str) -> list[str]:
    means = [mean_size(parts[room].get(key)) for room in rooms if room in parts]
    stated = published.MEAN_ERRORS.get(in_paper)
    focal = mean_of(abs(errors[0]) for room in rooms if (errors := parts.get(room, {}).get(key)))
    errors = [number(mean_of(means)) + answered(means), number(_largest(means)), number(focal)]
    return [shown, *errors, NONE if stated is None else f"{stated}"]


def _largest(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def table_1_two_views(parts: Parts) -> str:
    """COLMAP's two views; of random starts also the median of further draws, as a mean would be the farthest's."""
    draws = [figures["R, further draws"] for figures in parts.values()]
    rows = []
    for start in STARTS:
        decoded, corrected = (
            [mean_size(figures.get(start + lenses)) for figures in parts.values()] for lenses in ("", LENSES_CORRECTED)
        )
        redrawn = [_median(mean_size(draw[start]) for draw in room) for room in draws if start in room[0]]
        stated = f"{published.MEAN_ERRORS[start]}"
        means = (f"{number(mean_of(each))}{answered(each)}" for each in (decoded, corrected, redrawn))
        rows.append([start, *means, stated])
    further = f"median of {len(draws[0])} further random starts"
    return table(["COLMAP, two views: error, %", "mean", "lenses corrected", further, "the paper's own figure"], rows)


def table_1_both_points(parts: Parts) -> str:
    """COLMAP's two views and the refined method, told that lenses are ideal and where both principal points are.

    Means over the focal lengths alone, as the principal points have no error.
    """
    found = [figures[BOTH_POINTS] for figures in parts.values()]
    rows = []
    for shown, key in KNOWING:
        means = [mean_size(errors[:2] if (errors := each[key]) else None) for each in found]
        rows.append([shown, number(mean_of(means)) + answered(means), number(_largest(means))])
    return table([f"{BOTH_POINTS}: error of f_c and f_p, %", "mean", "worst room"], rows)


def _median(values: Iterable[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return float(np.median(there)) if there else None


def _many_views_row(parts: Parts) -> list[str]:
    views = next(iter(parts.values()))["views"]
    focal = mean_of(None if figures["f_c"] is None else abs(figures["f_c"]) for figures in parts.values())
    stated = f"{published.MEAN_ERRORS['COLMAP, 20 views']}"
    return [f"COLMAP, {views} views of textured walls (f_c only)", NONE, NONE, number(focal), stated]


def table_2(parts: Parts) -> tuple[str, Pictures]:
    """The ten objectives; means over the rooms."""
    means = {key: _by_configuration(parts, key) for key in ("as decoded", "lenses corrected")}
    numbers = range(1, len(published.CONFIGURATIONS) + 1)
    names = [*(f"E_{i}" for i in range(1, 8)), "E_pro", "E_cycle", "E"]
    rows = [[key, *map(number, values)] for key, values in means.items()]
    rows.append(["the paper's own figures", *(f"{value}" for value in published.CONFIGURATIONS)])
    lines = {key: list(zip(map(float, numbers), values, strict=True)) for key, values in means.items()}
    lines["the paper's own figures"] = list(zip(map(float, numbers), published.CONFIGURATIONS, strict=True))
    plot = curves(
        Axis("configuration: E_1 … E_7, E_pro, E_cycle, E"),
        "mean absolute error (%)",
        lines,
        "errors of the ten objectives",
        {"the paper's own figures": "published"},
    )
    return table(["mean absolute error, %", *names], rows), {"table2.svg": plot}


def _by_configuration(parts: Parts, key: str) -> list[float | None]:
    count = len(published.CONFIGURATIONS)
    return [mean_of(mean_size(room[key][i]) for room in parts.values()) for i in range(count)]


def table_3(parts: Parts) -> tuple[str, Pictures]:
    """The errors at each rate of downsampling; means over the rooms."""
    methods = ("paper", "paper, lenses corrected", "refined")
    rates = list(published.DOWNSAMPLED)
    means = {method: [_at_rate(parts, rate, mean_error(method)) for rate in rates] for method in methods}
    matches = [_at_rate(parts, rate, lambda figures: float(figures["matches"])) for rate in rates]
    rows = [["matches, mean", *(f"{value:.0f}" for value in matches if value is not None)]]
    rows += [[method_name(method), *map(number, values)] for method, values in means.items()]
    rows.append(["the paper's own figures", *(f"{value:.2f}" for value in published.DOWNSAMPLED.values())])
    lines = {method_name(method): list(zip(map(float, rates), values, strict=True)) for method, values in means.items()}
    lines["the paper's own figures"] = [(float(rate), error) for rate, error in published.DOWNSAMPLED.items()]
    plot = curves(
        Axis("one match in", log=True),
        "mean absolute error (%)",
        lines,
        "errors over the rate of downsampling",
        {"the paper's own figures": "published"},
    )
    return table(["mean absolute error, %; one match in", *map(str, rates)], rows), {"table3.svg": plot}


def mean_error(method: str) -> Callable[[Figures], float | None]:
    """Function from the values of a part to the mean absolute error of a method."""
    return lambda figures: mean_size(figures[method])


def _at_rate(parts: Parts, rate: int, value: Callable[[Figures], float | None]) -> float | None:
    return mean_of(value(room[str(rate)]) for room in parts.values())
