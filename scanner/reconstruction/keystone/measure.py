"""Measurement of keystone correction: the homography by which the projector reshapes its picture, from its loss of
contrast.

Where a pixel of the picture falls between two pixels of the panel, the finest stripes lose contrast; where it falls on
one, they keep it. Along both axes the loss beats with the shift between picture and panel, with crests at whole shifts.
The shift is that of a homography, so a fit over the picture determines it to a small part of a pixel, up to its sign,
because opposite shifts have the same beat. A projector only makes pictures smaller, which determines the sign.

Matches in the pixels of the projector's panel, where it reshapes the picture that is sent to it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import Shift
from calib.finding import Finding, FindingKind, Severity, without_kinds
from calib.geometry import Matches, mapped
from calib.numerics import Floats, Ints, evenly
from scanner.capture import CHANGED_SHAPE
from scanner.decoding import FinestStripes, first_harmonics
from scanner.quantities import percent
from scanner.reconstruction.keystone.beat import EVERYTHING, LEANS, Beat, BeatFit, homography_of, planes_at
from scanner.reconstruction.keystone.starts import Spectrum, starts, starts_about_both_axes
from scanner.results import AS_SHOWN, Decoded, Panel

# Wider stripes lose less than 2 %.
_LONGEST_PX = 16.0
_MOST_AT_FIRST = 4000
# More harmonics are more accurate, but converge only from nearby.
_ROUND, _SHARP = first_harmonics(1), first_harmonics(5)
KEYSTONE_CORRECTED = FindingKind(
    "keystone-corrected",
    "The projector corrects its picture for keystone, as the beat of the finest stripes shows; it was removed.",
    "Turn the correction off for captures that are to use this calibration.",
    ("narrower_share",),
)


@dataclass(frozen=True)
class Keystone:
    """`homography` (3, 3): from the picture's pixels to the panel's, whose origin is known up to whole pixels.

    `narrower`: share by which the far edge is smaller than the near one. `shifts`: errors of panel pixels, as fields of
    one standard deviation.
    """

    homography: Floats
    narrower: float
    shifts: tuple[Shift, ...]


def measure_keystone(stripes: FinestStripes, matches: Matches, plane: Ints, size: tuple[int, int]) -> Keystone | None:
    """Measure how the projector of (width, height) pixels reshapes its picture, if it does.

    `plane` (N,): the plane of each match, negative for none. Contrast varies smoothly over each plane.
    """
    if max(stripes.periods) > _LONGEST_PX or not len(stripes.log_ratio) or not len(matches):
        return None
    # A few pixels detect a keystone; all of them estimate it.
    few = evenly(np.ones(len(stripes.log_ratio), np.bool_), _MOST_AT_FIRST)
    thin = _beat(stripes.at(few), matches, plane, size)
    start = None if thin is None else _found_at_first(thin)
    beat = None if start is None else _beat(stripes, matches, plane, size)
    if beat is None or start is None:
        return None
    fit = replace(beat, wave=_SHARP).refined(start.values, start.free)
    return _keystone(fit, size) if fit.is_of_a_beat and beat.leans(fit) else None


def _beat(stripes: FinestStripes, matches: Matches, plane: Ints, size: tuple[int, int]) -> Beat | None:
    where = planes_at(stripes.camera_px, matches.camera_px, plane)
    return Beat.of(stripes, where, size, _ROUND)


def _found_at_first(thin: Beat) -> BeatFit | None:
    """The homography that explains how contrasts beat; None where none does."""
    sharp, spectrum = replace(thin, wave=_SHARP), Spectrum.of(thin)
    for likely in (starts, starts_about_both_axes):
        fits = [thin.refined(start.values, start.free) for start in likely(thin, spectrum)]
        if fits:
            best = max(fits, key=lambda fit: fit.explained)
            fit = sharp.refined(best.values, best.free)
            fit = sharp.believable(sharp.refined(fit.values, EVERYTHING), fit)
            # A wrong keystone explains only a part of the picture.
            if fit.is_of_a_beat and not Spectrum.of(sharp.without(fit)).beats:
                return fit
    return None


def _keystone(fit: BeatFit, size: tuple[int, int]) -> Keystone:
    """The homography between pixels, and the fields of its standard deviations."""
    homography = _between_pixels(fit.values, size)
    eigenvalues, directions = np.linalg.eigh(fit.covariance)
    steps = [np.sqrt(value) * way for value, way in zip(eigenvalues, directions.T, strict=True) if value > 0]
    back = np.linalg.inv(homography)

    def shifted(step: Floats) -> Shift:
        stepped = _between_pixels(fit.values + step, size) @ back

        def shift(_camera_px: Floats, projector_px: Floats, _gradient: Floats) -> Floats:
            return mapped(stepped, projector_px) - projector_px

        return shift

    narrower = 2 * np.abs(fit.values[LEANS]) * (1.0, size[1] / size[0])
    return Keystone(homography, float(narrower.max()), tuple(map(shifted, steps)))


def _between_pixels(values: Floats, size: tuple[int, int]) -> Floats:
    """The homography (3, 3) of these numbers, from pixels to pixels."""
    half, middle_y = (size[0] - 1) / 2, (size[1] - 1) / 2
    to_units = np.array([[1, 0, -half], [0, 1, -middle_y], [0, 0, half]]) / half
    return np.linalg.inv(to_units) @ homography_of(values) @ to_units


def on_panel(capture: Decoded, references: Sequence[Decoded] = ()) -> Decoded:
    """A capture with known planes, with its matches in square panel pixels, as far as its stripes determine them.

    The origin of the panel is that of `references` of the same rig, if they have one.
    """
    decoding, plane = capture.decoding, capture.matches.face if capture.plane is None else capture.plane
    if capture.panel is not None or decoding is None or decoding.stripes is None or plane is None:
        return capture
    size = capture.metadata.projector_size
    keystone = measure_keystone(decoding.stripes, capture.matches, plane, size)
    if keystone is None:
        return replace(capture, panel=AS_SHOWN)
    homography = keystone.homography
    for reference in references:
        if reference.panel is not None and reference.panel is not AS_SHOWN:
            homography = beginning_as(reference.panel.homography, homography, size)
            break
    matches = replace(capture.matches, projector_px=mapped(homography, capture.matches.projector_px))
    # A check before the scan suspected keystone correction; the capture has measured it.
    findings = without_kinds(decoding.findings, CHANGED_SHAPE)
    panel = Panel(homography, keystone.shifts)
    measured = replace(capture, matches=matches, panel=panel, origin=replace(decoding, findings=findings))
    return measured.with_findings(_finding(keystone))


def beginning_as(reference: Floats, homography: Floats, size: tuple[int, int]) -> Floats:
    """The homography by whole pixels of the panel nearer to another one."""
    middle = (np.array([size], np.float64) - 1) / 2
    (apart,) = np.rint(mapped(reference, middle) - mapped(homography, middle))
    return np.array([[1, 0, apart[0]], [0, 1, apart[1]], [0, 0, 1]]) @ homography


def _finding(keystone: Keystone) -> Finding:
    return Finding(
        KEYSTONE_CORRECTED,
        Severity.WARNING,
        f"The projector corrects its picture for keystone: one edge is {percent(keystone.narrower)} narrower than the "
        "other, as the beat of the finest stripes shows. This was measured and corrected: matches and calibration "
        "are in pixels of the projector's panel, as if it showed its picture as it is.",
        KEYSTONE_CORRECTED.remedy,
        {"narrower_share": float(keystone.narrower)},
    )
