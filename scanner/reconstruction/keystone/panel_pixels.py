"""Matches in the pixels of the projector's panel, where it reshapes the picture that is sent to it."""

from dataclasses import replace

from calib.geometry import mapped
from scanner.capture import CHANGED_SHAPE
from scanner.quantities import percent
from scanner.reconstruction.keystone.measure import Keystone, measure_keystone
from scanner.results import Decoded


def on_panel(capture: Decoded) -> Decoded:
    """A capture whose planes are known, with its matches in pixels that are square, as far as its stripes tell."""
    decoding, plane = capture.decoding, capture.matches.face if capture.plane is None else capture.plane
    if capture.panel is not None or decoding is None or decoding.stripes is None or plane is None:
        return capture
    keystone = measure_keystone(decoding.stripes, capture.matches, plane, capture.facts.projector_size)
    if keystone is None:
        return replace(capture, panel=())
    matches = replace(capture.matches, projector_px=mapped(keystone.homography, capture.matches.projector_px))
    # What five pictures before a scan made suspect was measured.
    warnings = tuple(warning for warning in decoding.warnings if not warning.startswith(CHANGED_SHAPE))
    measured = replace(capture, matches=matches, panel=keystone.shifts, origin=replace(decoding, warnings=warnings))
    return measured.noting(_said(keystone))


def _said(keystone: Keystone) -> str:
    return (
        f"The projector corrects its picture for keystone: one edge is {percent(keystone.narrower)} narrower than the "
        "other, as the beat of the finest stripes tells. That was measured and taken out: matches and calibration "
        "are in pixels of the projector's panel, as if it showed its picture as it is. Turn the correction off for "
        "captures that are to use this calibration."
    )
