"""Drop bits of a Gray code whose stripes the lenses do not resolve, and decode longer cells instead.

A bit is weak where its contrast is a small share of the coarse bits' contrast at the same pixel. It then follows
sharpening, crosstalk and stray light rather than the pattern. Weak bits are dropped if that decides more pixels than
their finer cells are worth, or if it makes neighbouring cells adjacent. Where camera pixels are larger than cells, so
that most of them lack some bit, each pixel uses the bits that it has.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image, lines_of
from scanner.decoding.axis_decoder import least_contrasts
from scanner.decoding.checks.code_checks import check_codes
from scanner.decoding.codes.gray_code import cell_numbers
from scanner.decoding.codes.gray_fold import GrayFold
from scanner.decoding.folded_frames import FoldedFrames
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.significance import FARTHEST_PX, FEWEST_PIXELS, NEARLY_ALL
from scanner.errors import InputError

# Least 90 % quantile of a bit's contrast relative to the coarse bits': half of it is lost midway between two stripes
# anyway. An exchanged frame does not make a bit weak.
_WEAK = 0.25


def resolve_bits(folded: FoldedFrames, noise: NoiseModel, pixels: NDArray[np.int64]) -> Iterator[str]:
    """Drop the bits that are not resolved at sample pixels (P,); yield a warning for each code."""
    chosen = []
    for fold in folded.codes:
        resolved, count = _resolved(folded, fold, noise, pixels) if fold.fine else (fold, 0)
        chosen.append(resolved)
        if count:
            code = fold.code
            bits = ", ".join(str(bit) for bit in range(code.bits - count, code.bits))
            yield (
                f"Bit {bits} of the Gray code along {code.axis} is too fine for the lenses and was left out: cells of "
                f"{chosen[-1].code.cell} px are decoded. Focus camera and projector, or move closer."
            )
    folded.decode_as(chosen)


def _resolved(
    folded: FoldedFrames, fold: GrayFold, noise: NoiseModel, pixels: NDArray[np.int64]
) -> tuple[GrayFold, int]:
    """Return the code to decode, and the number of bits dropped."""

    def at(image: Image) -> Image:
        return image.reshape(-1)[pixels]

    contrast = at(fold.least if fold.contrast is None else fold.contrast)
    certain_from, seen_from = least_contrasts(noise, at(folded.middle))
    lit = contrast > seen_from
    if np.count_nonzero(lit) < FEWEST_PIXELS:
        return fold.without_finest(0), 0
    weak = 0
    for bit in sorted(fold.fine, reverse=True):
        if np.quantile(at(fold.fine[bit])[lit] / contrast[lit], NEARLY_ALL) >= _WEAK:
            break
        weak += 1
    folds = [fold.without_finest(count) for count in range(weak + 1)]
    # A cell twice as long is worth a quarter, as its variance is four times as large.
    decided = [float(np.mean(at(one.least)[lit] > certain_from[lit])) for one in folds]
    count = _count_left_out(folded, folds, noise, int(np.argmax(np.array(decided) / 4.0 ** np.arange(weak + 1))))
    # A bit is undecided at the edge of its stripe: where pixels are larger than cells, nearly all are near an edge.
    few = decided[count] < NEARLY_ALL
    return fold.without_finest(count, optional=few and _cells_per_pixel(folded, fold, noise) > 1), count


def _cells_per_pixel(folded: FoldedFrames, fold: GrayFold, noise: NoiseModel) -> float:
    """Return the median number of finest cells between adjacent camera pixels."""
    squares = 0.0
    for is_transposed in (False, True):
        words, least, middle = (
            lines_of(image.T if is_transposed else image) for image in (fold.words, fold.least, folded.middle)
        )
        number = cell_numbers(words).astype(np.float32)
        certain = least > least_contrasts(noise, middle)[0]
        both = certain[:, FARTHEST_PX:] & certain[:, :-FARTHEST_PX]
        apart = np.abs(number[:, FARTHEST_PX:] - number[:, :-FARTHEST_PX])[both]
        squares += float(np.median(apart)) ** 2 if apart.size else 0.0
    return float(np.sqrt(squares)) / FARTHEST_PX


def _count_left_out(folded: FoldedFrames, folds: Sequence[GrayFold], noise: NoiseModel, fewest: int) -> int:
    """Return the least number of bits to drop, from `fewest` on, such that cells that differ in one
    bit are adjacent.
    """
    for count in range(fewest, len(folds) - 1):
        try:
            if not check_codes(folded.plan, [folds[count]], noise, folded.middle, folded.brightest):
                return count
        except InputError:
            continue
    return len(folds) - 1
