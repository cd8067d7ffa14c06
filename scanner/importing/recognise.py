"""Whose order of frames is it? Every order that is long enough is tried on the images."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calib.geometry import Matches
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.importing.frame_files import FrameFiles
from scanner.importing.glance import objection, share_on_epipolar_lines
from scanner.importing.layout import Candidate, Given, Layout, Size, candidates
from scanner.importing.projector_size import extents_of, find_sizes
from scanner.importing.samples import Samples
from scanner.io import read_image
from scanner.patterns import Pattern
from scanner.ui import Progress

# Fringes of few steps may err by more than a line is wide; in a wrong order a few hundredths are on lines by chance.
_LEAST_ON_LINES = 0.3
_OPTIONS = {"projector_size": "--projector", "cell": "--cell"}


@dataclass(frozen=True)
class Recognised:
    """A layout that fits: which pattern each of the `files` shows, on a projector of (width, height). `how`: why so.

    `likely`: whether such projectors are usual, and how many ends of their codes were seen.
    """

    layout: Layout
    files: tuple[Path, ...]
    patterns: tuple[Pattern, ...]
    projector_size: Size
    how: str
    likely: tuple[bool, int] = (True, 0)


@dataclass(frozen=True)
class Rejected:
    """A layout that does not fit, and why not; `lacking`: it would, if what it says were given."""

    layout: Layout
    why: str
    lacking: bool = False


def recognise(
    files: FrameFiles, layouts: Iterable[Layout], given: Given, samples: Samples, progress: Progress
) -> tuple[list[Recognised], list[Rejected]]:
    """Which of the layouts the frames have, and why not the others. Raises InputError for a file beside the frames."""
    decoder, found, rejected = _OnceDecoded(progress), list[Recognised](), list[Rejected]()
    for layout in layouts:
        known = given.or_else(layout.settings(files.folder))
        possible = list(candidates(layout, files, known))
        objections = [objection(samples, candidate.patterns) for candidate in possible]
        fitting = [candidate for candidate, against in zip(possible, objections, strict=True) if against is None]
        results = [_judge(layout, candidate, known, samples.camera_size, decoder) for candidate in fitting]
        good = [result for result in results if isinstance(result, Recognised)]
        if good:
            found += good
        elif results:
            bad = [result for result in results if isinstance(result, Rejected)]
            rejected.append(max(bad, key=lambda each: each.lacking))
        else:
            rejected.append(_why_not(layout, known, files, [against for against in objections if against]))
    return found, rejected


def _why_not(layout: Layout, given: Given, files: FrameFiles, objections: Sequence[str]) -> Rejected:
    if objections:
        # Of several variants the last objection comes from the one that got farthest.
        return Rejected(layout, max(objections, key=_progress_of))
    size = "" if given.projector_size is None else f" for a projector of {_shown(given.projector_size)}"
    return Rejected(layout, f"it has no sequence of {len(files.numbered)} frames{size}")


def _progress_of(objection: str) -> int:
    """How far a look at the frames came before this was in the way."""
    stages = ("hardly", "not brighter", "fringes", "never changes", "neither bright", "unrelated", "mirrored", "obey")
    return next((number for number, words in enumerate(stages) if words in objection), len(stages))


def _judge(
    layout: Layout, candidate: Candidate, given: Given, camera_size: Size, decoder: "_OnceDecoded"
) -> Recognised | Rejected:
    if layout.lacks(given):
        options = " and ".join(_OPTIONS[name] for name in layout.needs)
        return Rejected(layout, f"may be, but its frames do not tell the projector: give {options}", lacking=True)
    axes = {p.axis for p in candidate.patterns if hasattr(p, "axis")}
    if len(axes) < 2:
        if not candidate.size_known:
            return Rejected(layout, "one axis alone does not tell the projector's size: give --projector", lacking=True)
        return _recognised(
            layout, candidate, candidate.projector_size, "one axis only, so there is no second to check by"
        )
    decoded = decoder.decode(candidate)
    if isinstance(decoded, str):
        return Rejected(layout, decoded)
    share = share_on_epipolar_lines(decoded.camera_px, decoded.projector_px)
    if share < _LEAST_ON_LINES:
        return Rejected(layout, f"decodes, but only {share:.0%} of the matches obey one epipolar geometry")
    how = f"{len(decoded):,} matches, {share:.0%} of them on the lines of one epipolar geometry"
    if candidate.size_known:
        return _recognised(layout, candidate, candidate.projector_size, how)
    x, y = extents_of(candidate, decoded, camera_size)
    seen = f"codes from {x.low} to {x.high} in x, from {y.low} to {y.high} in y"
    sizes = find_sizes(candidate, decoded, camera_size, given)
    if len(sizes) != 1:
        possible = ", or ".join(_shown(found.size) for found in sizes) or "none that is usual"
        return Rejected(
            layout, f"decodes, but the projector's size is not clear, {possible} ({seen}): give --projector", True
        )
    found = _recognised(layout, candidate, sizes[0].size, f"{how}; {seen}")
    return replace(found, likely=(sizes[0].usual, sizes[0].total))


def _recognised(layout: Layout, candidate: Candidate, size: Size, how: str) -> Recognised:
    return Recognised(layout, candidate.files, candidate.for_size(size), size, how)


def _shown(size: Size) -> str:
    return f"{size[0]} × {size[1]}"


class _OnceDecoded:
    """Decodes the frames in an order; orders that several layouts share only once."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._found: dict[tuple[tuple[Pattern, ...], Size], Matches | str] = {}

    def decode(self, candidate: Candidate) -> Matches | str:
        """The matches, or why there are none."""
        key = candidate.patterns, candidate.projector_size
        if key not in self._found:
            self._found[key] = self._decode(candidate)
        return self._found[key]

    def _decode(self, candidate: Candidate) -> Matches | str:
        try:
            decoder = Decoder(candidate.patterns, candidate.projector_size)
        except InputError as error:
            return str(error)
        for path in self._progress.track(candidate.files, len(candidate.files), "Decoding"):
            decoder.add(read_image(path))
        try:
            matches = decoder.finish().matches
        except InputError as error:
            return f"does not decode: {error}"
        return matches if len(matches) else "decodes to no match at all"
