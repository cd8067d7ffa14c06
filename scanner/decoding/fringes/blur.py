"""Loss of contrast by lens blur: how much weaker the longest fringe is than the stripes, and whether it is resolved.

Interreflection weakens fringes and stripes alike, relative to white. Lens blur weakens fringes more than the middle of
a stripe, which separates the two.
"""

from collections.abc import Iterator

import numpy as np
from scipy.special import erf

from calib.numerics import Floats32, evenly_spread
from scanner.decoding.axis_decoder import largest_variance, least_contrasts
from scanner.decoding.axis_signals import Signals, signals_of
from scanner.decoding.folded_frames import FoldedFrames
from scanner.decoding.light.noise_model import STRAY_PART, NoiseModel
from scanner.decoding.samples import Sample
from scanner.decoding.sequence_plan import AxisPlan
from scanner.decoding.significance import BRIGHTEST, FEW, FEWEST_PIXELS, HALF, NEARLY_ALL

# Blurs that are distinguished: the largest leaves hardly any of the stripes.
_BLURS_CELLS = np.linspace(0.01, 2.0, 200)
# The blur of lenses in focus is not corrected: underestimating the direct light would mask more doubtful bits.
_IN_FOCUS = 1.5


def weakened(axis: AxisPlan, least: Floats32, amplitude: Floats32) -> float:
    """Return the factor by which lens blur weakens the longest fringe; at least 1.

    From the smallest contrast (P,) of the bits and the fringe's amplitude (P,) at lit pixels. A blur of σ leaves
    exp(−2π²σ²/λ²) of a fringe, and erf(d / √2 σ) of the contrast at a distance d from an edge.
    """
    if not len(least):
        return 1.0
    # Nearly all pixels are nearer to an edge between two cells than this share of half a cell.
    found = float(np.quantile(least / (2 * amplitude), NEARLY_ALL))
    blur_px = _BLURS_CELLS * axis.cell
    times = np.exp(2 * (np.pi * blur_px / axis.fringes[0].period) ** 2)
    of_stripes = erf(NEARLY_ALL * axis.cell / 2 / (np.sqrt(2) * blur_px))
    weaker = float(np.interp(found, of_stripes * times, times, left=1.0))
    return weaker if weaker > _IN_FOCUS else 1.0


def drop_lost_fringes(folded: FoldedFrames, noise: NoiseModel, sample: Sample) -> Iterator[str]:
    """Drop all fringes if blur leaves hardly any on an axis with a code, judged by a sample; yield a warning."""
    pixels = evenly_spread(sample.pixels)
    signals = signals_of(
        folded, lambda image: image.reshape(1, -1)[:, pixels], lambda frame: evenly_spread(sample.level(frame))
    )
    lost = [
        axis
        for axis, of_axis in zip(folded.plan.axes, signals, strict=True)
        if axis.codes and axis.fringes and _is_lost(axis, of_axis, folded, noise, sample)
    ]
    if lost and all(axis.codes for axis in folded.plan.axes):
        folded.forget_fringes()
        cell = max(axis.cell for axis in lost)
        yield (
            f"The fringes along {' and '.join(axis.axis for axis in lost)} are blurred away and were left out: cells "
            f"of the Gray code of {cell:g} px are decoded. Focus camera and projector."
        )


def _is_lost(axis: AxisPlan, signals: Signals, folded: FoldedFrames, noise: NoiseModel, sample: Sample) -> bool:
    certain_from, seen_from = least_contrasts(noise, signals.middle)
    # Light from other surfaces may lie on one side of the threshold in all bits without an inverse, as by a tone curve:
    # only where fine bits differ are their stripes seen.
    fine = sorted({frame for code in axis.codes for frame in code.fine_frames})
    least = np.ptp([evenly_spread(sample.level(frame)) for frame in fine], axis=0)
    for fold in folded.codes:
        if fold.code in axis.codes:
            least = np.minimum(least, fold.least.reshape(-1)[evenly_spread(sample.pixels)])
    # Ambient light that was switched on decides bits at unlit pixels, too.
    half_lit = signals.brightest - signals.middle
    # Stray light, which cameras of many bits detect, has no fringes either.
    lit = half_lit > STRAY_PART * np.quantile(half_lit, BRIGHTEST)
    decided = (least > certain_from) & (2 * half_lit > seen_from) & lit
    if np.count_nonzero(decided) < FEWEST_PIXELS:
        return False
    cosine, sine = signals.fringe(0)
    fringe = axis.fringes[0]
    variance = (fringe.period / (2 * np.pi) * fringe.noise_gain) ** 2 * noise.variance(signals.middle)
    power = cosine**2 + sine**2
    # Motion adds noise and breaks fringes, but leaves their amplitude.
    seen = (variance <= largest_variance(fringe, with_gray=True) * power) | (power > (FEW * half_lit) ** 2)
    # It would leave out most of the pixels that decode all bits.
    return bool(np.mean(seen[decided]) < HALF)
