"""Tables 1 to 3 on the page."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from paper import published
from paper.experiment import Figures
from paper.markdown import NONE, answered, mean_of, mean_size, method_name, number, table
from paper.plots import Axis, curves

Parts = dict[str, Figures]
Pictures = dict[str, str]
_NOT_MEASURED = "not measured"
# A method's name on the page, its key in the results, and its key among the published values.
OWN_METHODS = (
    ("the paper's method, true faces", "paper, true faces", "paper"),
    ("the paper's method, automatic faces", "paper, automatic faces", "paper"),
    ("the paper's method, true faces, lenses corrected", "paper, true faces, lenses corrected", "paper"),
    ("**refined**, PP known", "refined, PP known", ""),
    ("**refined**, PP unknown", "refined, PP unknown", ""),
    ("**refined**, PP unknown, walls square to ± 0.3° only", "refined, PP and walls unknown", ""),
    ("**refined**, two captures jointly, PP unknown", "refined, two captures, PP unknown", ""),
)
TWO_VIEW_METHODS = (
    ("COLMAP, two views, C", "C", "C"),
    ("COLMAP, two views, C-BA", "C-BA", "C-BA"),
    ("COLMAP, two views, R", "R", "R"),
    ("COLMAP, two views, R-BA", "R-BA", "R-BA"),
    ("COLMAP, two views, C, lenses corrected", "C, lenses corrected", ""),
    ("COLMAP, two views, C-BA, lenses corrected", "C-BA, lenses corrected", ""),
    ("COLMAP, two views, R, lenses corrected", "R, lenses corrected", ""),
    ("COLMAP, two views, R-BA, lenses corrected", "R-BA, lenses corrected", ""),
)


def table_1(own: Parts, two_views: Parts, many_views: Parts) -> str:
    """Mean absolute errors of each method in each room. Signed errors are in `results/table1*.json`."""
    rooms = sorted(own)
    rows = [_method_row(own, rooms, *method) for method in OWN_METHODS]
    rows += [_method_row(two_views, rooms, *method) for method in TWO_VIEW_METHODS] if two_views else []
    rows += [_draws_row(two_views, rooms, name) for name in ("R", "R-BA")] if two_views else []
    rows += [_many_views_row(many_views, rooms)] if many_views else []
    rows.append(
        [
            "DroidCalib, 20 views (f_c only; needs weights and a GPU: quoted)",
            *[NONE] * (len(rooms) + 2),
            f"{published.MEAN_ERRORS['DroidCalib, 20 views']}",
        ]
    )
    head = ["mean absolute error, %", *rooms, "mean", "f_c alone, mean", "the paper's own figure"]
    return table(head, rows)


def _method_row(parts: Parts, rooms: Sequence[str], shown: str, key: str, in_paper: str) -> list[str]:
    means = [mean_size(parts.get(room, {}).get(key)) for room in rooms]
    stated = published.MEAN_ERRORS.get(in_paper)
    cells = [number(mean) if room in parts else _NOT_MEASURED for room, mean in zip(rooms, means, strict=True)]
    there = [mean for room, mean in zip(rooms, means, strict=True) if room in parts]
    focal = mean_of(abs(errors[0]) for room in rooms if (errors := parts.get(room, {}).get(key)))
    stated_there = NONE if stated is None else f"{stated}"
    return [shown, *cells, number(mean_of(there)) + answered(there), number(focal), stated_there]


def _draws_row(parts: Parts, rooms: Sequence[str], key: str) -> list[str]:
    """Median over a room's draws, because diverged ones would dominate the mean."""
    draws = {room: [mean_size(draw[key]) for draw in figures["R, further draws"]] for room, figures in parts.items()}
    medians = {room: _median(errors) for room, errors in draws.items()}
    cells = [number(medians[room]) if room in parts else _NOT_MEASURED for room in rooms]
    count = len(next(iter(draws.values())))
    shown = f"COLMAP, two views, {key}, median of {count} further random starts"
    return [shown, *cells, number(mean_of(medians.values())), NONE, NONE]


def _median(values: Iterable[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return float(np.median(there)) if there else None


def _many_views_row(parts: Parts, rooms: Sequence[str]) -> list[str]:
    errors = {room: figures["f_c"] for room, figures in parts.items()}
    sizes = {room: None if error is None else abs(error) for room, error in errors.items()}
    cells = [number(sizes[room]) if room in parts else _NOT_MEASURED for room in rooms]
    first = next(iter(parts.values()))
    shown = f"COLMAP, {first['views']} views of textured walls (f_c only)"
    return [shown, *cells, NONE, number(mean_of(sizes.values())), f"{published.MEAN_ERRORS['COLMAP, 20 views']}"]


def paper_by_room() -> str:
    """The paper's own method in the paper's four scenes."""
    rows = [[f"No. {i}", *(number(e, signed=True) for e in errors)] for i, errors in enumerate(published.OWN_ERRORS, 1)]
    return table(["the paper's four scenes, truth − estimate, %", *published.PER_CENT_OF], rows)


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
