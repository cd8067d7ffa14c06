"""Whose order of frames is it? Every order that is long enough is tried on the images."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from calib.geometry import Matches
from calib.refusal import RefusalError
from scanner.decoding import Decoder, MaskReason
from scanner.errors import InputError
from scanner.importing.frame_files import FrameFiles, read_frame
from scanner.importing.incomplete import MISSING_ENDS, without_duplicates, without_ends
from scanner.importing.layout import MOST_FRAMES, Candidate, FrameLayout, Given, Size, candidates
from scanner.importing.plausibility import (
    Objection,
    OrderStage,
    best_fitting,
    broken_order,
    faint_bits,
    objection,
    share_on_epipolar_lines,
    unresolved_bits,
)
from scanner.importing.projector_size import constant_axes, extents_of, find_sizes, is_clear, show_size
from scanner.importing.samples import LevelSamples, take_lines
from scanner.patterns import Axis, Gray, Pattern, Phase
from scanner.ui import Progress

# Coordinates from few steps may err by more than the limit; in a wrong order, a few hundredths fit by chance.
_LEAST_ON_LINES = 0.3
_FEWEST_MATCHES = 8  # that determine a fundamental matrix
# Share of the lit pixels whose coordinates are beyond a projector of the right size, at blurred rims.
_MOST_OUTSIDE = 0.1
_MOST_FAINT = 3  # bits that may be left out because of their contrast
_CLEAR = (
    OrderStage.MIRRORED,
    OrderStage.OPTIONS,
    OrderStage.SIZE,
)  # reasons that end the search: the order itself fits
_OPTIONS = {"projector_size": "--projector", "cell": "--cell", "periods": "--periods"}


@dataclass(frozen=True)
class Recognised:
    """A layout that fits."""

    layout: FrameLayout
    files: tuple[Path, ...]
    patterns: tuple[Pattern, ...]
    """The pattern that each of the files shows."""
    projector_size: Size
    """(width, height)"""
    how: str
    """Why it fits."""
    likely: tuple[bool, int, bool] = (True, 0, True)
    """Whether such projectors are usual, how many ends of their codes were seen, whether the order counts them so."""


@dataclass(frozen=True)
class Rejected:
    """A layout that does not fit."""

    layout: FrameLayout
    why: str
    stage: OrderStage = OrderStage.COUNT
    """How far the closest variant got."""
    reached: float = 0.0
    """The share of the next stage that it passed."""


def recognise(
    files: FrameFiles,
    layouts: Sequence[FrameLayout],
    given: Given,
    look: Callable[[], LevelSamples],
    progress: Progress,
    flip: Axis | None = None,
) -> tuple[list[Recognised], list[Rejected]]:
    """Which layouts fit the frames, and why the others do not, the closest first.

    Raises InputError for a file beside the frames. `look` reads the frames, which are mirrored back along the axis
    `flip`, if any layout has this number. With a single layout and a given projector, frames that look right need not
    decode. If no layout fits, white and black may be missing, or there are frames too many.
    """
    judge = _Judge(progress, flip, lenient=len(layouts) == 1)
    recognised, rejected = list[Recognised](), dict[str, Rejected]()
    for attempt in _attempts(files, layouts, look):
        recognised, reasons = _tried(attempt, given, judge)
        nearest = max((reason.stage for reason in rejected.values()), default=OrderStage.COUNT)
        for reason in reasons:
            before = rejected.get(reason.layout.name)
            # How far they get with other frames than there are says less than why these do not fit.
            counts = not attempt.is_altered or nearest < reason.stage >= OrderStage.DECODING
            if before is None or (counts and _distance(reason) > _distance(before)):
                rejected[reason.layout.name] = reason
        # One that fits only because a frame is thought to be missing may do so by chance.
        is_clear_reason = not attempt.is_altered and any(reason.stage in _CLEAR for reason in reasons)
        if recognised or is_clear_reason:
            names = {choice.layout.name for choice in recognised}
            rejected = {name: reason for name, reason in rejected.items() if name not in names}
            break
    return recognised, sorted(rejected.values(), key=_distance, reverse=True)


def _distance(reason: Rejected | Objection) -> tuple[OrderStage, float]:
    return reason.stage, reason.reached


@dataclass(frozen=True)
class _Attempt:
    """What to try."""

    files: FrameFiles
    layouts: Sequence[FrameLayout]
    look: Callable[[], LevelSamples]
    """Reads the samples of the files."""
    missing: tuple[Pattern, ...] = ()
    """The patterns that were not taken."""
    is_altered: bool = True
    """Whether patterns are missing, or frames are left out."""


def _attempts(
    files: FrameFiles, layouts: Sequence[FrameLayout], look: Callable[[], LevelSamples]
) -> Iterator[_Attempt]:
    """Yield what to try, the usual first."""
    is_only = len(layouts) == 1
    usual, last = ([layout for layout in layouts if layout.last == is_last or is_only] for is_last in (False, True))
    yield _Attempt(files, usual, look, is_altered=False)
    for missing in MISSING_ENDS:
        yield _Attempt(files, usual, look, missing)
    if len(files.numbered) > MOST_FRAMES:
        return
    for fewer, samples in without_duplicates(files, look()):
        yield from (_Attempt(fewer, some, partial(_unchanged, samples)) for some in (usual, last))
    yield _Attempt(files, last, look, is_altered=False)
    for fewer, samples in without_ends(files, look()):
        yield from (_Attempt(fewer, some, partial(_unchanged, samples)) for some in (usual, last))


def _unchanged(samples: LevelSamples) -> LevelSamples:
    return samples


def _tried(attempt: _Attempt, given: Given, judge: "_Judge") -> tuple[list[Recognised], list[Rejected]]:
    """Which of the layouts the frames have."""
    recognised, rejected = list[Recognised](), list[Rejected]()
    for layout in attempt.layouts:
        known = given.or_else(layout.settings(attempt.files.folder))
        possible = list(candidates(layout, attempt.files, known, attempt.missing))
        objections = [objection(attempt.look(), candidate.patterns) for candidate in possible]
        fitting = [candidate for candidate, against in zip(possible, objections, strict=True) if against is None]
        against = [(objected, candidate) for objected, candidate in zip(objections, possible, strict=True) if objected]
        if fitting:
            best = best_fitting(attempt.look(), [candidate.patterns for candidate in fitting])
            fitting = [fitting[number] for number in best]
        results = [result for candidate in fitting for result in judge.judge(layout, candidate, known, attempt.look())]
        good = [result for result in results if isinstance(result, Recognised)]
        bad = [result for result in results if isinstance(result, Rejected)]
        if good:
            recognised += good
        elif possible:
            reasons = bad
            if against and not any(reason.stage > OrderStage.MIRRORED for reason in bad):
                # The variant whose objection comes last is the closest.
                objected, candidate = max(against, key=lambda pair: _distance(pair[0]))
                if not bad or objected.stage == OrderStage.MIRRORED:
                    reasons = [*bad, judge.reject(layout, objected, candidate)]
            rejected.append(max(reasons, key=_distance))
        else:
            size = "" if known.projector_size is None else f" for a projector of {show_size(known.projector_size)}"
            rejected.append(Rejected(layout, f"it has no sequence of {len(attempt.files.numbered)} frames{size}"))
    return recognised, rejected


class _Judge:
    """Decodes all frames in the orders that look right; those that several layouts share only once."""

    def __init__(self, progress: Progress, flip: Axis | None, *, lenient: bool) -> None:
        self._progress = progress
        self._flip = flip
        self._lenient = lenient
        self._decoded: dict[tuple[tuple[Path, ...], tuple[Pattern, ...], Size, Axis | None], Matches | str] = {}
        self._lines: dict[tuple[tuple[Path, ...], Axis], LevelSamples] = {}

    def judge(
        self, layout: FrameLayout, candidate: Candidate, given: Given, samples: LevelSamples
    ) -> Sequence[Recognised | Rejected]:
        """Whether the frames decode in this order, and the projectors that they fit."""
        if layout.lacks(given):
            lacking = [_OPTIONS[name] for name in layout.needs if getattr(given, name) is None]
            why = f"is possible, but its frames do not determine the projector: give {' and '.join(lacking)}"
            return [Rejected(layout, why, OrderStage.OPTIONS)]
        axes = {p.axis for p in candidate.patterns if isinstance(p, Gray | Phase)}
        if len(axes) < 2:
            return [self._by_one_axis(layout, candidate, given, *axes)]
        decoded, candidate, note = self._decode_resolved(candidate, samples)
        if isinstance(decoded, str):
            return [self._undecoded(layout, candidate, given, decoded)]
        share = share_on_epipolar_lines(decoded.camera_px, decoded.projector_px)
        how = f"{len(decoded):,} matches, {share:.0%} of them on the lines of one epipolar geometry{note}"
        if candidate.size_known:
            return [Recognised(layout, candidate.files, candidate.patterns, candidate.projector_size, how)]
        return self._sized(layout, candidate, given if not note else replace(given, codes=None), how, decoded, samples)

    def _sized(
        self, layout: FrameLayout, candidate: Candidate, given: Given, how: str, matches: Matches, samples: LevelSamples
    ) -> Sequence[Recognised | Rejected]:
        """The projectors whose codes are those of the matches: one, or all among which to choose."""
        extents = extents_of(candidate, matches, samples.camera_size)
        fits = find_sizes(candidate, extents, given)
        codes = (
            f"codes from {extents[0].low} to {extents[0].high} in x, from {extents[1].low} to {extents[1].high} in y"
        )
        if given.projector_size and not (self._lenient and fits):
            usual = find_sizes(candidate, extents, replace(given, projector_size=None))
            if not fits or (fits[0].is_contradicted and usual and usual[0].total > fits[0].total):
                possible = ", or ".join(map(str, usual)) or "none that is usual"
                why = f"decodes, but its {codes} are not those of a projector of {show_size(given.projector_size)}"
                return [Rejected(layout, f"{why}; they fit {possible}", OrderStage.SIZE)]
        is_usual = any(fit.is_usual for fit in fits)
        if not given.projector_size and not is_usual and (axes := constant_axes(candidate, extents)):
            why = f"decodes, but only with two frames as bits of {' and '.join(axes)} that never change"
            return [Rejected(layout, why, OrderStage.GEOMETRY, 1.0)]
        if not fits:
            why = f"decodes, but its {codes} fit no usual projector: give --projector"
            return [Rejected(layout, why, OrderStage.SIZE)]
        if len(fits) == 1 and not is_clear(fits, given):
            why = f"decodes, and its {codes} fit {fits[0]}; if it is that, give --projector"
            return [Rejected(layout, why, OrderStage.SIZE)]
        chosen = fits[:1] if is_clear(fits, given) else fits
        also = f"; as well possible, --projector: {', '.join(map(str, fits[1:]))}" if len(chosen) < len(fits) else ""
        return [
            Recognised(
                layout,
                candidate.files,
                fit.patterns,
                fit.size,
                f"{how}; {codes}{'' if fit.is_own else ', counted from the middle'}{also}"
                + (f"; {fit.reason}" if len(chosen) > 1 else ""),
                (fit.is_usual, fit.total, fit.is_own),
            )
            for fit in chosen
        ]

    def _undecoded(self, layout: FrameLayout, candidate: Candidate, given: Given, why: str) -> Recognised | Rejected:
        """Accept what does not decode only if it was asked for."""
        patterns = _on_given(candidate, given) if self._lenient else None
        if patterns and given.projector_size:
            return Recognised(layout, candidate.files, patterns, given.projector_size, f"not checked: {why}")
        all_the_same = f"--from {layout.name} and --projector accept it nevertheless"
        return Rejected(layout, f"looks right, but {why}; {all_the_same}", OrderStage.DECODING)

    def reject(self, layout: FrameLayout, objection: Objection, candidate: Candidate) -> Rejected:
        """The objection to a candidate; one that looks mirrored is only so if it decodes once it is mirrored back."""
        mirrored = None if objection.flip is None else self._decode(candidate, objection.flip)
        if isinstance(mirrored, str):
            return Rejected(layout, f"looks mirrored, but mirrored back {mirrored}", OrderStage.GEOMETRY, 1.0)
        return Rejected(layout, objection.words, objection.stage, objection.reached)

    def _by_one_axis(
        self, layout: FrameLayout, candidate: Candidate, given: Given, axis: Axis
    ) -> Recognised | Rejected:
        if (candidate.files, axis) not in self._lines:
            self._lines[candidate.files, axis] = take_lines(candidate.files, axis, self._flip)
        broken = broken_order(self._lines[candidate.files, axis], candidate.patterns, axis)
        if broken:
            return Rejected(layout, broken, OrderStage.DECODING)
        if given.projector_size is None:
            why = f"looks right along {axis}, but one axis does not determine the projector's size: give --projector"
            return Rejected(layout, why, OrderStage.SIZE)
        patterns = _on_given(candidate, given)
        if patterns is None:
            return Rejected(
                layout, f"its codes are not those of {show_size(given.projector_size)}", OrderStage.NEIGHBOURS
            )
        coded = any(isinstance(pattern, Gray) for pattern in patterns)
        how = "neighbouring pixels are in neighbouring cells" if coded else "no second axis to check it by"
        return Recognised(layout, candidate.files, patterns, given.projector_size, f"one axis, {how}")

    def _decode_resolved(self, candidate: Candidate, samples: LevelSamples) -> tuple[Matches | str, Candidate, str]:
        """The matches, or the reason why there are none, without the finest bits that the camera does not resolve.

        Bits of little contrast are left out if the others decode only without them. Returns the candidate that was
        decoded, and what was left out of it.
        """
        unresolved = unresolved_bits(samples, candidate.patterns)
        has_fringes = any(isinstance(pattern, Phase) for pattern in candidate.patterns)
        faint = {} if has_fringes else faint_bits(samples, candidate.patterns)
        first: Matches | str | None = None
        for count in range(_MOST_FAINT + 1):
            counts = {axis: max(lost, min(count, faint.get(axis, 0))) for axis, lost in unresolved.items()}
            fewer = candidate.without_finest(counts)
            decoded = self._decode(fewer)
            if not isinstance(decoded, str):
                return decoded, fewer, _left_out(candidate, counts)
            first = first or decoded
            if count >= max(faint.values(), default=0):
                break
        return first or "", candidate, ""

    def _decode(self, candidate: Candidate, flip: Axis | None = None) -> Matches | str:
        key = candidate.files, candidate.patterns, candidate.projector_size, flip
        if key not in self._decoded:
            self._decoded[key] = self._decode_anew(candidate, flip or self._flip)
        return self._decoded[key]

    def _decode_anew(self, candidate: Candidate, flip: Axis | None) -> Matches | str:
        try:
            decoder = Decoder(candidate.patterns, candidate.projector_size)
            for path in self._progress.track(candidate.files, len(candidate.files), "Decoding"):
                decoder.add(read_frame(path, flip))
            decoding = decoder.finish()
        except (InputError, RefusalError) as error:
            return f"does not decode: {error}"
        matches = decoding.matches
        if len(matches) < _FEWEST_MATCHES:
            return f"decodes to {len(matches) or 'no'} matches"
        share = share_on_epipolar_lines(matches.camera_px, matches.projector_px)
        if share < _LEAST_ON_LINES:
            return f"decodes, but only {share:.0%} of the matches obey one epipolar geometry"
        outside, kept = (int((decoding.reasons == reason).sum()) for reason in (MaskReason.OUTSIDE, MaskReason.KEPT))
        if outside > _MOST_OUTSIDE * (outside + kept):
            size = show_size(candidate.projector_size)
            return f"decodes, but {outside / (outside + kept):.0%} of the pixels are outside a projector of {size}"
        return matches


def _on_given(candidate: Candidate, given: Given) -> tuple[Pattern, ...] | None:
    """The patterns of a candidate on the given projector; None if it has other codes, or is not given."""
    if candidate.size_known or given.projector_size is None:
        return candidate.patterns if candidate.size_known else None
    size = given.projector_size
    return next((patterns for cell in given.cells for patterns in candidate.on(size, cell)), None)


def _left_out(candidate: Candidate, counts: Mapping[Axis, int]) -> str:
    """What was left out, in words: the numbers of the finest bits."""
    bits = {p.axis: p.bits for p in candidate.patterns if isinstance(p, Gray)}
    parts = [
        f"bit {', '.join(map(str, range(bits[axis] - count, bits[axis])))} of {axis}"
        for axis, count in counts.items()
        if count
    ]
    return f", without {' and '.join(parts)}, whose stripes are too fine for the lenses" if parts else ""
