"""Check that each frame of a Gray code shows the bit that the capture states.

Exchanged bits decode to plausible numbers. But neighbouring cells of a Gray code differ in one bit only. If adjacent
camera pixels differ in a single bit, their cells must therefore be neighbours.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from math import sqrt

import numpy as np

from calib.finding import Finding
from calib.numerics import Bools, Image, Ints, Words, compiled, lines_of
from scanner.decoding.codes.gray_code import CodeWords, cell_numbers
from scanner.decoding.light import LEFT_BY_SWAP, LIT, MOST_BROKEN, STRAY_PART, NoiseModel, anomaly
from scanner.decoding.sequence_plan import FINE_BITS, GrayCode, SequencePlan
from scanner.decoding.significance import BRIGHTEST, FARTHEST_PX, FEWEST_COUNTED, OUTLYING_SIGMAS
from scanner.errors import FramesError

# Smaller differences are rounding and compression, in grey levels, or stray light, whose bits are unreliable, as a
# share of the brightest pixels (STRAY_PART), which matters for cameras with many bits and little noise.
_LEAST_DIFFERENCE = 5.0
# If the camera resolves the cells, nearly all changes are in a single bit; stripes finer than its pixels are not
# checked.
_MOSTLY_SINGLE = 0.8


@dataclass(frozen=True)
class _Changes:
    """Pairs of pixels whose code words differ in a single bit: their words, and the number of that bit, (C,) each."""

    before: Words
    after: Words
    bit: Ints

    def __getitem__(self, chosen: Bools) -> "_Changes":
        return _Changes(self.before[chosen], self.after[chosen], self.bit[chosen])

    def adjacent(self) -> Bools:
        """Return whether the two cells are neighbours, as they must be."""
        before, after = cell_numbers(self.before), cell_numbers(self.after)
        step: Words = np.maximum(before, after) - np.minimum(before, after)
        adjacent: Bools = step == 1
        return adjacent

    def repaired(self, code: GrayCode, swap: tuple[int, int]) -> "_Changes":
        """Return the changes with two bits, as displayed, exchanged; with one bit inverted if both are the same."""
        first, second = (np.uint32(code.bits - 1 - bit) for bit in swap)

        def repair(words: Words) -> Words:
            displayed = code.relative_to_base(words)
            differ = np.uint32(1) if first == second else (displayed >> first ^ displayed >> second) & np.uint32(1)
            return code.relative_to_base(displayed ^ (differ << first | differ << second))

        return _Changes(repair(self.before), repair(self.after), self.bit)


def check_codes(
    plan: SequencePlan,
    all_words: Sequence[CodeWords],
    noise: NoiseModel,
    threshold: Image,
    white: Image,
    moved: Bools | None = None,
) -> list[Finding]:
    """Return the anomalies of Gray codes whose single-bit changes do not join neighbouring cells.

    `threshold` (H, W): grey level half-way between lit and unlit; `white` (H, W): grey level when lit; `moved` (H, W):
    pixels to ignore. Raises InputError if exchanging two bits, or inverting one, removes the contradictions.
    """
    anomalies = []
    bases = {
        (code_words.code.axis, code_words.code.cell, code_words.code.offset)
        for code_words in all_words
        if code_words.code.base is not None
    }
    for code_words, changes in chain.from_iterable(
        _sampled(code_words, noise, threshold, white, moved) for code_words in all_words
    ):
        wrong = changes[~changes.adjacent()]
        if len(wrong.bit) < FEWEST_COUNTED:
            continue
        _require_unrepairable(plan, code_words.code, changes, len(wrong.bit))
        if (
            code_words.code.base is None
            and (code_words.code.axis, code_words.code.cell, code_words.code.offset) in bases
        ):
            continue  # interreflection may have flipped bits: the XOR code is checked instead
        bits = [bit for bit in range(code_words.code.bits) if _is_unrelated(changes.bit == bit, wrong, bit)]
        if bits:
            # Whether two cells are neighbours depends on the changing bit and on all finer ones.
            suspects = code_words.code.frames_of(range(min(bits), code_words.code.bits))
            message = (
                f"in the Gray code along {code_words.code.axis}, cells that differ in bit {', '.join(map(str, bits))} "
                f"only are not neighbours, as they must be; was a frame exchanged with another? {plan.names(suspects)}"
            )
            anomalies.append(anomaly(message, suspects))
    return anomalies


def _sampled(
    code_words: CodeWords, noise: NoiseModel, threshold: Image, white: Image, moved: Bools | None
) -> Iterator[tuple[CodeWords, _Changes]]:
    """Yield the code and its changes, then those of a coarser code if single cells are not resolved.

    The finest bits are dropped until all pixels are smaller than cells. Errors in coarse bits then become visible.
    """
    changes, are_single = _changes(code_words, noise, threshold, white, moved)
    yield code_words, changes
    coarser = code_words
    while not are_single and code_words.code.base is None and coarser.code.bits > FINE_BITS:
        coarser = coarser.without_finest(1)
        changes, are_single = _changes(coarser, noise, threshold, white, moved)
    if coarser is not code_words:
        yield coarser, changes


def _changes(
    code_words: CodeWords, noise: NoiseModel, threshold: Image, white: Image, moved: Bools | None
) -> tuple[_Changes, bool]:
    """Return the single-bit changes between reliable pixels along some rows and columns of the image.

    A direction is used only if most of its changes are single. The flag is true if both directions are used.
    """
    before, after = [np.empty(0, np.uint32)], [np.empty(0, np.uint32)]
    for is_transposed in (False, True):
        words, least, level, of_white = (
            lines_of(image.T if is_transposed else image)
            for image in (code_words.words, code_words.least, threshold, white)
        )
        least_clear = max(_LEAST_DIFFERENCE, STRAY_PART * float(np.quantile(least[:, ::FARTHEST_PX], BRIGHTEST)))
        certain = least > np.maximum(least_clear, np.float32(OUTLYING_SIGMAS * sqrt(2)) * noise.sigma(level))
        swing = of_white.astype(np.float32) - level
        certain &= swing >= np.float32(LIT) * np.quantile(swing[:, ::FARTHEST_PX], BRIGHTEST)
        if moved is not None:
            certain &= ~lines_of(moved.T if is_transposed else moved)
        word, next_one = np.empty((2, words.size), np.uint32)
        single, changes = _note_changes(words.astype(np.uint32), certain, FARTHEST_PX, word, next_one)
        if single >= _MOSTLY_SINGLE * changes:
            before.append(word[:single])
            after.append(next_one[:single])
    words_before, words_after = np.concatenate(before), np.concatenate(after)
    place = np.rint(np.log2(words_before ^ words_after)).astype(np.int64)
    return _Changes(words_before, words_after, code_words.code.bits - 1 - place), len(before) == 3


@compiled
def _note_changes(words: Words, certain: Bools, farthest: int, before: Words, after: Words) -> tuple[int, int]:
    """Record words of successive reliable pixels of lines (lines, P), `farthest` apart at most, that differ in one bit.

    Returns the number of these, and the number of successive pixels that differ at all.
    """
    single = changes = 0
    for line in range(words.shape[0]):
        last = -1
        for place in range(words.shape[1]):
            if not certain[line, place]:
                continue
            if last >= 0 and place - last <= farthest:
                change = words[line, place] ^ words[line, last]
                changes += change != 0
                if change != 0 and change & (change - 1) == 0:
                    before[single], after[single] = words[line, last], words[line, place]
                    single += 1
            last = place
    return single, changes


def _require_unrepairable(plan: SequencePlan, code: GrayCode, changes: _Changes, wrong: int) -> None:
    swaps = [*combinations(range(code.bits), 2), *((bit, bit) for bit in range(code.bits))]
    wrong_after = [np.count_nonzero(~changes.repaired(code, swap).adjacent()) for swap in swaps]
    if min(wrong_after) > LEFT_BY_SWAP * wrong:
        return
    first, second = swaps[int(np.argmin(wrong_after))]
    names = plan.names(code.frames_of((first, second)))
    if first == second:
        raise FramesError(
            f"the code along {code.axis} makes sense only with the opposite of bit {first}", f"see {names}"
        )
    problem = f"the code along {code.axis} makes sense only with bits {first} and {second} exchanged"
    raise FramesError(problem, f"see {names}")


def _is_unrelated(of_bit: Bools, wrong: _Changes, bit: int) -> bool:
    """Return whether a bit changes in many places, but too rarely between neighbouring cells.

    A single pair of cells that meet at an occlusion edge may differ in one bit by chance.
    """
    chosen = wrong[wrong.bit == bit]
    if len(chosen.bit) < max(FEWEST_COUNTED, MOST_BROKEN * np.count_nonzero(of_bit)):
        return False
    _, counts = np.unique(np.minimum(chosen.before, chosen.after), return_counts=True)
    return bool(counts.max() < len(chosen.bit) / 2)
