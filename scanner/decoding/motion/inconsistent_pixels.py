"""Detection of pixels whose frames contradict each other while those of other pixels agree: something moved there.

A corrupted frame violates the constraints of light/constraints.py all over the picture. A moving object or its shadow
violates them in patches, outside of which all frames agree.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from math import hypot
from typing import cast

import cv2
import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Bools, Floats32
from scanner.decoding.coordinates import SMALLEST_PATCH
from scanner.decoding.light import STATIC_SHARE, GridSample, NoiseModel, find_violations, frames_of_fine_bits
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import BRIGHTEST, FEW

# A quick test on a subsample of the grid: with so few contradictions, nothing moved.
_STRIDE, _A_FEW = 4, 2
# Window, and the least share of it that is lit, and of the lit pixels in it that are inconsistent, where something
# moved; both object and background light its edges.
_WINDOW, _DENSE = 9, 0.3
# A transient object is gone again in later frames: its pixels are inconsistent in about one group of frames, and in
# many after a bump of the camera. Largest shift of the whole picture, in pixels of the grid.
_TRANSIENT, _MOVED_PX = 1.5, 0.5

MOVING_OBJECT = FindingKind(
    "moving-object",
    "Something moved in a part of the picture, which was masked.",
    "Keep people and things that move out of the picture.",
    ("moved_share", "frames"),
)


@dataclass(frozen=True)
class InconsistentPixels:
    """Pixels where something moved."""

    moved: Bools
    """(H, W): where."""
    corrupted: Bools
    """(H, W): without a usable coordinate, where fringes changed. With fringes, changes of codes alone are found later,
    as period slips (wrong_bits.py).
    """
    static: Bools
    """(H, W): lit, and nothing moved."""
    share: float
    """Of the lit pixels, where something moved."""
    frames: tuple[int, ...]
    """Those that contradict others where something moved."""
    corrupted_by_frames: Mapping[tuple[int, ...], Bools] = field(default_factory=dict)
    """With codes alone, and if what moved is gone in later frames: the pixels (H, W) at which a pattern and its inverse
    contradict the others, by their frames.
    """

    def finding(self, plan: SequencePlan) -> Finding:
        """Return the warning for the operator."""
        return Finding(
            MOVING_OBJECT,
            Severity.WARNING,
            f"Something moved in {max(self.share, 0.01):.0%} of the lit picture, which shows in "
            f"{plan.names(self.frames)}; the affected pixels were masked, and the rest is used.",
            data={"moved_share": self.share, "frames": self.frames},
        )


def find_inconsistent_pixels(plan: SequencePlan, grid: GridSample, noise: NoiseModel) -> InconsistentPixels | None:
    """Return the pixels where something moved; None if nothing did, or nearly all of what is lit."""
    levels = grid.levels
    swing = np.ptp(levels, axis=0)
    lit: Bools = swing > max(FEW * float(np.quantile(swing, BRIGHTEST)), 1e-6)
    some = np.zeros_like(lit)
    some[::_STRIDE, ::_STRIDE] = lit[::_STRIDE, ::_STRIDE]
    if sum(np.count_nonzero(pixels) for _, pixels in find_violations(plan, levels[:, some], noise)) <= _A_FEW:
        return None
    groups = find_violations(plan, levels[:, lit], noise)
    inconsistent = _any_of((pixels for _, pixels in groups), lit)
    moved = patches(inconsistent, lit)
    inside = moved[lit]
    share = float(inside.mean()) if len(inside) else 0.0
    is_transient = _is_transient(groups, inconsistent[lit])
    if not 0 < share <= (1 if is_transient else 1 - STATIC_SHARE):
        return None
    frames = {frame for of, pixels in groups if pixels[inside].mean() > FEW for frame in of}
    if not frames or _picture_moved(levels, [of for of, _ in groups], frames, lit & ~moved):
        return None
    if plan.fringes:
        corrupted = _corrupted(plan, levels, lit, moved, noise, is_transient=is_transient)
    else:
        corrupted = moved & (inconsistent | _in_fine_bits(plan, groups, lit)) if is_transient else moved
    static = grid.at_full_size(lit & ~moved & ~_grown(inconsistent, 3))
    return InconsistentPixels(
        grid.at_full_size(moved),
        grid.at_full_size(corrupted),
        static,
        share,
        tuple(sorted(frames)),
        {} if plan.fringes or not is_transient else dict(_corrupted_by_frames(grid, groups, lit)),
    )


def _corrupted_by_frames(
    grid: GridSample, groups: list[tuple[tuple[int, ...], Bools]], lit: Bools
) -> Iterator[tuple[tuple[int, ...], Bools]]:
    """Yield the frames of each group, with the pixels (H, W) at which they contradict the others and those between."""
    for frames, pixels in groups:
        if np.count_nonzero(pixels) >= SMALLEST_PATCH:
            contradicting = _any_of([pixels], lit)
            yield frames, grid.at_full_size(contradicting | patches(contradicting, lit))


def _any_of(of_groups: Iterable[Bools], lit: Bools) -> Bools:
    """Return the pixels (h, w) that are in any of some sets (P,) of the lit ones."""
    chosen = np.zeros(lit.shape, np.bool_)
    for pixels in of_groups:
        chosen[lit] |= pixels
    return chosen


def _grown(some: Bools, side: int) -> Bools:
    """Return the pixels (h, w) in whose window, a square of this side, are some of these."""
    return cast(Bools, cv2.dilate(some.astype(np.uint8), np.ones((side, side), np.uint8)).astype(np.bool_))


def _is_transient(groups: list[tuple[tuple[int, ...], Bools]], inconsistent: Bools) -> bool:
    """Return whether pixels in `inconsistent` (P,) are inconsistent in about one group of frames each.

    Several checks may flag the same group.
    """
    times = sum(
        np.count_nonzero(np.any([pixels for of, pixels in groups if of == frames], axis=0))
        for frames in {of for of, _ in groups}
    )
    return bool(times <= _TRANSIENT * np.count_nonzero(inconsistent))


def _in_fine_bits(plan: SequencePlan, groups: list[tuple[tuple[int, ...], Bools]], lit: Bools) -> Bools:
    """Return the patches (h, w) that changed during fine bits, where an error of a few cells looks plausible."""
    fine = frames_of_fine_bits(plan)
    return patches(_any_of((pixels for frames, pixels in groups if fine.intersection(frames)), lit), lit)


def _corrupted(
    plan: SequencePlan, levels: Floats32, lit: Bools, moved: Bools, noise: NoiseModel, *, is_transient: bool
) -> Bools:
    """Return the pixels (h, w) at which fringes changed; a pixel that is dark anyway keeps its coordinate in a shadow.

    All fringes of an axis but the last only select its period. If a change `is_transient`, an error in them is
    harmless, or shows as a contradiction or a period slip. A lasting change may show in only some of the fringes.
    """
    fringes = [axis.fringes[-1] for axis in plan.axes if axis.fringes] if is_transient else plan.fringes
    frames = {fringe.frames for fringe in fringes}
    groups = find_violations(plan, levels[:, lit], noise, ~moved[lit])
    inconsistent = _any_of((pixels for of, pixels in groups if of in frames), lit)
    return inconsistent & _grown(moved, _WINDOW)


def _picture_moved(levels: Floats32, groups: list[tuple[int, ...]], frames: set[int], static: Bools) -> bool:
    """Return whether the whole picture, `levels` (frames, h, w), is shifted in the contradicting `frames`: a camera
    bump.

    If it was a large object instead, undoing its shift does not improve the agreement at the `static` pixels (h, w).
    """
    even = [group for group in groups if len(group) > 1]
    contradicting, agreeing = (
        [levels[list(group)].mean(axis=0) for group in even if frames.issuperset(group) == is_odd]
        for is_odd in (True, False)
    )
    if not contradicting or not agreeing:
        return False
    window = cast(Floats32, cv2.createHanningWindow((levels.shape[2], levels.shape[1]), cv2.CV_32F))
    before, after = (np.log1p(np.stack(pictures).mean(axis=0)) for pictures in (agreeing, contradicting))
    (right, down), _ = cv2.phaseCorrelate(before, after, window)
    if hypot(right, down) <= _MOVED_PX:
        return False
    back = np.array([[1.0, 0.0, -right], [0.0, 1.0, -down]])
    taken_back = cv2.warpAffine(after, back, after.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    error, error_as_seen = (float(np.abs(image - before)[static].sum()) for image in (taken_back, after))
    return error <= error_as_seen


def patches(inconsistent: Bools, lit: Bools) -> Bools:
    """Return connected patches (h, w), with a margin, in which many of the lit pixels are `inconsistent`."""
    dense = _dense(inconsistent, lit) & (_count_around(lit) > _DENSE * _WINDOW**2)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(dense.astype(np.uint8), connectivity=8)
    large = statistics[:, cv2.CC_STAT_AREA] >= SMALLEST_PATCH
    large[0] = False
    return _grown(large[labels], 3)


def _dense(inconsistent: Bools, lit: Bools) -> Bools:
    """Return the lit pixels (h, w) around which a large share of the lit ones are `inconsistent`."""
    return (_count_around(inconsistent & lit) > _DENSE * _count_around(lit)) & lit


def _count_around(some: Bools) -> Floats32:
    """Return the number of such pixels in the window around each pixel, (h, w)."""
    window = (_WINDOW, _WINDOW)
    count = cv2.boxFilter(some.astype(np.float32), -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return cast(Floats32, count)
