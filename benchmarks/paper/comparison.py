"""All comparisons in which a peer is better than the refined method."""

from collections.abc import Iterator, Mapping, Sequence

from paper.experiment import Results
from paper.markdown import mean_of, mean_size, method_name, number
from paper.page_tables import BOTH_POINTS, KNOWING, LENSES_CORRECTED, OWN_METHODS, STARTS, Parts

_REFINED = "refined"
_REFINED_METHODS = [key for _, key, _ in OWN_METHODS if key.startswith(_REFINED)]
_NOWHERE = "Nothing that was compared did better anywhere."


def where_peers_are_better(results: Results) -> str:
    """A list with a line for each such comparison."""
    own = results.read("table1")
    found = [
        *_intrinsics(own, results.read("table1-two-views")),
        *_knowing(results.read("table1-two-views")),
        *_focal_lengths(own, results.read("table1-many-views")),
        *_matches(results.read("table3")),
        *_sphere(results.read("figure7")),
        *_photos(results.read("figure8")),
        *_curves(results.read("beyond")),
    ]
    return "\n".join(f"- {line}" for line in found) or _NOWHERE


def _intrinsics(own: Parts, two_views: Parts) -> Iterator[str]:
    ours = {key: {room: mean_size(own[room][key]) for room in own} for key in _REFINED_METHODS}
    others = {key: own for _, key, _ in OWN_METHODS if key not in _REFINED_METHODS}
    others |= {start + lenses: two_views for start in STARTS for lenses in ("", LENSES_CORRECTED)}
    for other, parts in others.items():
        theirs = {room: mean_size(parts.get(room, {}).get(other)) for room in own}
        yield from _rooms_won(f"“{method_name(other)}”", theirs, ours)


def _knowing(two_views: Parts) -> Iterator[str]:
    """With both principal points known."""
    errors = {key: {room: mean_size(two_views[room][BOTH_POINTS][key]) for room in two_views} for _, key in KNOWING}
    ours = {key: errors[key] for key in errors if key.startswith(_REFINED)}
    for peer in errors.keys() - ours.keys():
        yield from _rooms_won(f"“{peer}” with both PP known", errors[peer], ours)


def _focal_lengths(own: Parts, many_views: Parts) -> Iterator[str]:
    """COLMAP's many views give the camera's focal length only."""
    shared = [room for room in own if room in many_views]
    ours = {key: {room: _focal(own[room][key]) for room in shared} for key in _REFINED_METHODS}
    theirs = {room: _focal([many_views[room]["f_c"]]) for room in shared}
    yield from _rooms_won("COLMAP's many views, in f_c,", theirs, ours)


def _focal(errors: Sequence[float | None] | None) -> float | None:
    """The size of the first error; None for no answer."""
    return abs(errors[0]) if errors and errors[0] is not None else None


def _rooms_won(
    peer: str, theirs: Mapping[str, float | None], ours: Mapping[str, Mapping[str, float | None]]
) -> Iterator[str]:
    """A line with the number of rooms in which a peer beats each variant; none if it never does."""
    won = {key: sum(_is_worse(errors[room], theirs[room]) for room in theirs) for key, errors in ours.items()}
    beaten = [f"“{key}” in {count}" for key, count in won.items() if count]
    if beaten:
        yield f"Table 1: {peer} errs less than {', '.join(beaten)} of {len(theirs)} rooms."


def _stated(error: float | None, unit: str) -> str:
    return "refuses" if error is None else f"by {number(error)} {unit}"


def _is_worse(ours: float | None, theirs: float | None) -> bool:
    """A refusal is worse than an answer."""
    return theirs is not None and (ours is None or ours > theirs)


def _matches(parts: Parts) -> Iterator[str]:
    rates = next(iter(parts.values()), {})
    for rate in rates:
        means = {
            key: mean_of(mean_size(room[rate][key]) for room in parts.values())
            for key in ("paper", "paper, lenses corrected", _REFINED)
        }
        for other in ("paper", "paper, lenses corrected"):
            if _is_worse(means[_REFINED], means[other]):
                yield (
                    f"Table 3, one match in {rate}: “{method_name(other)}” errs by {number(means[other])} %, "
                    f"“{_REFINED}” {_stated(means[_REFINED], '%')}."
                )


def _sphere(parts: Parts) -> Iterator[str]:
    for figure, of in (("mean_absolute_mm", "error of the fit"), ("diameter_error_mm", "error of the diameter")):
        for room, figures in parts.items():
            fits = {name: abs(fit[figure]) for name, fit in figures["methods"].items() if fit}
            ours = fits.pop(_REFINED, None)
            fits.pop("true calibration", None)
            for other, theirs in fits.items():
                if _is_worse(ours, theirs):
                    peer = f"“{method_name(other)}” errs by {number(theirs)} mm"
                    yield f"Figure 7, {room}, {of}: {peer}, “{_REFINED}” {_stated(ours, 'mm')}."


def _photos(parts: Parts) -> Iterator[str]:
    for room, kinds in parts.items():
        for photos, figures in kinds.items():
            ours = mean_size(figures[_REFINED])
            for peer in (key for key in figures if key.startswith("COLMAP")):
                theirs = mean_size(figures[peer])
                if _is_worse(ours, theirs):
                    off = f"“{peer}” is off by {number(theirs)} px"
                    yield f"Figure 8, {room}, {photos}: {off}, `scan photos` {_stated(ours, 'px')}."


def _curves(parts: Parts) -> Iterator[str]:
    for name, figures in parts.items():
        for point in figures["points"]:
            ours, theirs = point[_REFINED], point.get("paper")
            if _is_worse(ours, theirs):
                yield (
                    f"Beyond, {name} {point['at']:g}: the paper's method errs by {number(theirs)} % in the median, "
                    f"“{_REFINED}” {_stated(ours, '%')}."
                )
