"""Whose order of frames is it? Every order that is long enough is tried on the images."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from calib.geometry import Matches
from calib.refusal import RefusalError
from scanner.decoding import Decoder, MaskReason
from scanner.errors import InputError
from scanner.importing.continuity import broken_order
from scanner.importing.frame_files import FrameFiles
from scanner.importing.incomplete import MISSING_ENDS, without_duplicates
from scanner.importing.layout import MOST_FRAMES, Candidate, FrameLayout, Given, Size, candidates
from scanner.importing.plausibility import best_fitting, objection, share_on_epipolar_lines
from scanner.importing.projector_size import extents_of, possible_sizes
from scanner.importing.samples import LevelSamples, take_lines
from scanner.io import read_image
from scanner.patterns import Axis, Gray, Pattern, Phase
from scanner.ui import Progress

# Coordinates from few steps may err by more than the limit; in a wrong order, a few hundredths fit by chance.
_LEAST_ON_LINES = 0.3
# Of the pixels with a code; stray light decodes to some codes that a projector does not have.
_MOST_BEYOND = 0.1
_OPTIONS = {"projector_size": "--projector", "cell": "--cell"}


@dataclass(frozen=True)
class Recognised:
    """A layout that fits: the pattern that each of the `files` shows, on a projector of (width, height). `how`: the
    reason.

    `likely`: whether such projectors are sold, and how many ends of their codes were seen.
    """

    layout: FrameLayout
    files: tuple[Path, ...]
    patterns: tuple[Pattern, ...]
    projector_size: Size
    how: str
    likely: tuple[bool, int] = (True, 0)


@dataclass(frozen=True)
class Rejected:
    """A layout that does not fit, and the reason; `lacking`: it may fit with further options; `certain`: it would."""

    layout: FrameLayout
    why: str
    lacking: bool = False
    certain: bool = False


def recognise(
    files: FrameFiles,
    layouts: Sequence[FrameLayout],
    given: Given,
    look: Callable[[], LevelSamples],
    progress: Progress,
) -> tuple[list[Recognised], list[Rejected]]:
    """Which layouts fit the frames, and why the others do not. Raises InputError for a file beside the frames.

    `look` reads the frames, if any layout has this number. With a single layout and a given projector, frames that look
    right need not decode. If no layout fits, white and black may be missing, or a frame may be duplicated.
    """
    judge = _Judge(progress, lenient=len(layouts) == 1)
    usual = [layout for layout in layouts if not layout.last or len(layouts) == 1]
    found, rejected = _tried(files, usual, given, look, judge)
    if found or any(each.lacking for each in rejected):
        return found, rejected
    for less_usual in _less_usual(files, layouts, look):
        found, others = _tried(less_usual.files, less_usual.layouts, given, less_usual.look, judge, less_usual.missing)
        if found:
            return found, [each for each in rejected if each.layout not in {one.layout for one in found}]
        # Keep the reason against the last resort, and the layouts that only lack options.
        relevant = [each for each in others if each.lacking or each.layout.last]
        rejected = [each for each in rejected if each.layout not in {one.layout for one in relevant}] + relevant
    return [], rejected


@dataclass(frozen=True)
class _Attempt:
    """What to try next: of some `files`, whose samples are had by `look`, without the patterns that are `missing`."""

    files: FrameFiles
    layouts: Sequence[FrameLayout]
    look: Callable[[], LevelSamples]
    missing: tuple[Pattern, ...] = ()


def _less_usual(
    files: FrameFiles, layouts: Sequence[FrameLayout], look: Callable[[], LevelSamples]
) -> Iterator[_Attempt]:
    usual, last = ([layout for layout in layouts if layout.last == is_last] for is_last in (False, True))
    for missing in MISSING_ENDS:
        yield _Attempt(files, usual, look, missing)
    if len(files.numbered) > MOST_FRAMES:
        return
    for fewer, samples in without_duplicates(files, look()):
        seen = partial(_unchanged, samples)
        yield from (_Attempt(fewer, usual, seen), _Attempt(fewer, last, seen))
    yield _Attempt(files, last, look)


def _unchanged(samples: LevelSamples) -> LevelSamples:
    return samples


def _tried(
    files: FrameFiles,
    layouts: Sequence[FrameLayout],
    given: Given,
    look: Callable[[], LevelSamples],
    judge: "_Judge",
    missing: tuple[Pattern, ...] = (),
) -> tuple[list[Recognised], list[Rejected]]:
    """Which of the layouts the frames have, if those of the patterns that are `missing` were not taken."""
    found, rejected = list[Recognised](), list[Rejected]()
    for layout in layouts:
        known = given.or_else(layout.settings(files.folder))
        possible = list(candidates(layout, files, known, missing))
        objections = [objection(look(), candidate.patterns) for candidate in possible]
        fitting = [candidate for candidate, against in zip(possible, objections, strict=True) if against is None]
        if fitting:
            best = best_fitting(look(), [candidate.patterns for candidate in fitting])
            fitting = [fitting[number] for number in best]
        results = [judge.judge(layout, candidate, known, look().camera_size) for candidate in fitting]
        good = [recognised for result in results if not isinstance(result, Rejected) for recognised in result]
        bad = [result for result in results if isinstance(result, Rejected)]
        if good:
            found += good
        elif bad:
            rejected.append(max(bad, key=lambda each: (each.certain, each.lacking)))
        elif possible:
            # The variant whose objection comes last is the closest.
            nearest = max((against for against in objections if against), key=lambda against: against.stage)
            rejected.append(Rejected(layout, nearest.words))
        else:
            size = "" if known.projector_size is None else f" for a projector of {_shown(known.projector_size)}"
            rejected.append(Rejected(layout, f"it has no sequence of {len(files.numbered)} frames{size}"))
    return found, rejected


class _Judge:
    """Decodes all frames in the orders that look right; those that several layouts share only once."""

    def __init__(self, progress: Progress, *, lenient: bool) -> None:
        self._progress = progress
        self._lenient = lenient
        self._found: dict[tuple[tuple[Pattern, ...], Size], tuple[Matches, float] | str] = {}
        self._lines: dict[tuple[tuple[Path, ...], Axis], LevelSamples] = {}

    def judge(
        self, layout: FrameLayout, candidate: Candidate, given: Given, camera_size: Size
    ) -> list[Recognised] | Rejected:
        """Whether the frames decode in this order, and the projectors that may have shown them."""
        if layout.lacks(given):
            options = " and ".join(_OPTIONS[name] for name in layout.needs)
            return Rejected(
                layout, f"is possible, but its frames do not determine the projector: give {options}", lacking=True
            )
        axes = {p.axis for p in candidate.patterns if isinstance(p, Gray | Phase)}
        if len(axes) < 2:
            return self._by_one_axis(layout, candidate, *axes)
        decoded = self._decoded(candidate)
        if isinstance(decoded, str):
            if self._lenient and candidate.size_known:
                return [_recognised(layout, candidate, candidate.projector_size, f"not checked: {decoded}")]
            all_the_same = f"--from {layout.name} and --projector accept it nevertheless"
            return Rejected(layout, f"looks right, but {decoded}; {all_the_same}", lacking=True)
        matches, beyond = decoded
        share = share_on_epipolar_lines(matches.camera_px, matches.projector_px)
        how = f"{len(matches):,} matches, {share:.0%} of them on the lines of one epipolar geometry"
        if candidate.size_known and beyond > _MOST_BEYOND:
            size = _shown(candidate.projector_size)
            why = f"decodes, but {beyond:.0%} of the pixels see codes that a projector of {size} does not have: the"
            return Rejected(layout, f"{why} size is another, and without it what fits is listed", lacking=True)
        if candidate.size_known:
            return [_recognised(layout, candidate, candidate.projector_size, how)]
        extents = x, y = extents_of(candidate, matches, camera_size)
        seen = f"codes from {x.low} to {x.high} in x, from {y.low} to {y.high} in y"
        sizes = possible_sizes(candidate, extents, given)
        if not sizes:
            why = f"decodes, but the projector's size is not clear, none that is usual fits ({seen}): give --projector"
            return Rejected(layout, why, lacking=True)
        likely = sizes[0].rank > 0, sizes[0].total
        reasons = [f"; {fit.reason}" if len(sizes) > 1 else "" for fit in sizes]
        return [
            Recognised(layout, candidate.files, fit.patterns, fit.size, f"{how}; {seen}{reason}", likely)
            for fit, reason in zip(sizes, reasons, strict=True)
        ]

    def _by_one_axis(self, layout: FrameLayout, candidate: Candidate, axis: Axis) -> list[Recognised] | Rejected:
        if (candidate.files, axis) not in self._lines:
            self._lines[candidate.files, axis] = take_lines(candidate.files, axis)
        broken = broken_order(self._lines[candidate.files, axis], candidate.patterns, axis)
        if broken:
            return Rejected(layout, broken)
        if not candidate.size_known:
            why = f"looks right along {axis}, but one axis does not determine the projector's size: give --projector"
            return Rejected(layout, why, lacking=True, certain=True)
        coded = any(isinstance(pattern, Gray) for pattern in candidate.patterns)
        how = "neighbouring pixels are in neighbouring cells" if coded else "no second axis to check it by"
        return [_recognised(layout, candidate, candidate.projector_size, f"one axis, {how}")]

    def _decoded(self, candidate: Candidate) -> tuple[Matches, float] | str:
        """The matches, and the share of pixels with codes beyond the projector's; or the reason why there are none."""
        key = candidate.patterns, candidate.projector_size
        if key not in self._found:
            self._found[key] = self._decode(candidate)
        return self._found[key]

    def _decode(self, candidate: Candidate) -> tuple[Matches, float] | str:
        try:
            decoder = Decoder(candidate.patterns, candidate.projector_size)
            for path in self._progress.track(candidate.files, len(candidate.files), "Decoding"):
                decoder.add(read_image(path))
            decoding = decoder.finish()
        except (InputError, RefusalError) as error:
            return f"does not decode: {error}"
        matches = decoding.matches
        if not len(matches):
            return "decodes to no matches"
        share = share_on_epipolar_lines(matches.camera_px, matches.projector_px)
        if share < _LEAST_ON_LINES:
            return f"decodes, but only {share:.0%} of the matches obey one epipolar geometry"
        beyond = np.count_nonzero(decoding.reasons == MaskReason.OUTSIDE)
        return matches, beyond / (beyond + np.count_nonzero(decoding.reasons == MaskReason.KEPT))


def _recognised(layout: FrameLayout, candidate: Candidate, size: Size, how: str) -> Recognised:
    return Recognised(layout, candidate.files, candidate.for_size(size), size, how)


def _shown(size: Size) -> str:
    return f"{size[0]} × {size[1]}"
