"""All comparisons in which a peer is better than the refined method."""

from collections.abc import Iterator, Mapping

from paper.experiment import Results
from paper.markdown import mean_of, mean_size, method_name, number
from paper.page_tables import OWN_METHODS, TWO_VIEW_METHODS, Parts

_REFINED = "refined"
_NOWHERE = "Nothing that was compared did better anywhere."


def where_peers_are_better(results: Results) -> str:
    """A list with a line for each such comparison."""
    own = results.read("table1")
    found = [
        *_intrinsics(own, results.read("table1-two-views")),
        *_focal_lengths(own, results.read("table1-many-views")),
        *_matches(results.read("table3")),
        *_sphere(results.read("figure7")),
        *_photos(results.read("figure8")),
        *_curves(results.read("beyond")),
    ]
    return "\n".join(f"- {line}" for line in found) or _NOWHERE


def _intrinsics(own: Parts, two_views: Parts) -> Iterator[str]:
    refined_keys = [key for _, key, _ in OWN_METHODS if key.startswith(_REFINED)]
    others = {key: own for _, key, _ in OWN_METHODS if not key.startswith(_REFINED)}
    others |= {key: two_views for _, key, _ in TWO_VIEW_METHODS}
    for room in own:
        ours = {key: mean_size(own[room][key]) for key in refined_keys}
        for other, parts in others.items():
            theirs = mean_size(parts.get(room, {}).get(other))
            beaten = _beaten(ours, theirs)
            if beaten:
                yield f"Table 1, {room}: “{method_name(other)}” errs by {number(theirs)} %, {beaten}."


def _focal_lengths(own: Parts, many_views: Parts) -> Iterator[str]:
    """COLMAP's many views give the camera's focal length only."""
    for room in (room for room in own if room in many_views):
        error = many_views[room]["f_c"]
        keys = [key for _, key, _ in OWN_METHODS if key.startswith(_REFINED)]
        ours = {key: abs(own[room][key][0]) if own[room][key] else None for key in keys}
        theirs = None if error is None else abs(error)
        beaten = _beaten(ours, theirs)
        if beaten:
            views = many_views[room]["views"]
            yield f"Table 1, {room}: COLMAP's {views} views err by {number(theirs)} % in f_c, {beaten}."


def _beaten(ours: Mapping[str, float | None], theirs: float | None) -> str:
    worse = [f"“{key}” {_stated(value, '%')}" for key, value in ours.items() if _is_worse(value, theirs)]
    return ", ".join(worse)


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
