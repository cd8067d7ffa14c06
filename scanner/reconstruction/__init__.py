"""Captures → calibration → clouds → files."""

from scanner.reconstruction.calibrate import (
    calibrate,
    label,
    label_by_masks,
    read_masks,
    refuse_few,
    refuse_impossible,
    solve,
)
from scanner.reconstruction.earlier_captures import read_captures, shifts_of
from scanner.reconstruction.guidance import Guidance, guide
from scanner.reconstruction.merge_clouds import brightness, consistency, merge
from scanner.reconstruction.metric_scale import scaled, scaled_by_sheet
from scanner.reconstruction.priors import is_calibration, lenses_by_name, lenses_of
from scanner.reconstruction.reconstruct import OnCloud, reconstruct
from scanner.reconstruction.save import refusal_saved, save, set_aside
from scanner.reconstruction.triangulate import find_change_in, refuse_foreign, refuse_misfit, triangulate
