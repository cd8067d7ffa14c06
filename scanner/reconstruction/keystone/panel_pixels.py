"""Matches in the pixels of the projector's panel, where it reshapes the picture that is sent to it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.finding import Finding, FindingKind, Severity, without_kinds
from calib.geometry import mapped
from calib.numerics import Floats
from scanner.capture import CHANGED_SHAPE
from scanner.quantities import percent
from scanner.reconstruction.keystone.measure import Keystone, measure_keystone
from scanner.results import AS_SHOWN, Decoded, Panel

KEYSTONE_CORRECTED = FindingKind(
    "keystone-corrected",
    "The projector corrects its picture for keystone, as the beat of the finest stripes shows; it was removed.",
    "Turn the correction off for captures that are to use this calibration.",
    ("narrower_share",),
)


def on_panel(capture: Decoded, others: Sequence[Decoded] = ()) -> Decoded:
    """A capture with known planes, with its matches in square panel pixels, as far as its stripes determine them.

    The origin of the panel is that of `others` of the same rig, if they have one.
    """
    decoding, plane = capture.decoding, capture.matches.face if capture.plane is None else capture.plane
    if capture.panel is not None or decoding is None or decoding.stripes is None or plane is None:
        return capture
    size = capture.metadata.projector_size
    keystone = measure_keystone(decoding.stripes, capture.matches, plane, size)
    if keystone is None:
        return replace(capture, panel=AS_SHOWN)
    homography = keystone.homography
    for other in others:
        if other.panel is not None and other.panel is not AS_SHOWN:
            homography = beginning_as(other.panel.homography, homography, size)
            break
    matches = replace(capture.matches, projector_px=mapped(homography, capture.matches.projector_px))
    # A check before the scan suspected keystone correction; the capture has measured it.
    findings = without_kinds(decoding.findings, CHANGED_SHAPE)
    panel = Panel(homography, keystone.shifts)
    measured = replace(capture, matches=matches, panel=panel, origin=replace(decoding, findings=findings))
    return measured.with_findings(_finding(keystone))


def beginning_as(other: Floats, homography: Floats, size: tuple[int, int]) -> Floats:
    """The homography by whole pixels of the panel nearer to another one."""
    middle = (np.array([size], np.float64) - 1) / 2
    (apart,) = np.rint(mapped(other, middle) - mapped(homography, middle))
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
