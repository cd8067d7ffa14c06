"""Captures → calibration → clouds → what is saved."""

from scanner.reconstruction.calibrate import (
    refuse_few,
    refuse_foreign,
    refuse_impossible,
    refuse_misfit,
    self_calibration,
)
from scanner.reconstruction.earlier_captures import read_captures
from scanner.reconstruction.face_masks import label_by_masks, read_masks
from scanner.reconstruction.merge_clouds import brightness, consistency, merge
from scanner.reconstruction.metric_scale import scaled
from scanner.reconstruction.save import save, set_aside
