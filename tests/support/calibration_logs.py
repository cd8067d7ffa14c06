"""Logs of a calibration that drifted while the projector warmed up, and whose zoom was touched then."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from calib.geometry import Calibration, DeviceSigmas, Pose, Sigmas, rotation_about
from calib.synthetic import random_captures
from scanner.io import write_calibration
from scanner.results import LogEntry, entry_for, log_of, log_text

BEGUN = datetime(2026, 5, 4, 9, tzinfo=UTC)
ZOOMED, HOLDS = "the projector's focal length", "The calibration holds."
TOUCHED = 5
"""Number of the entry before which the zoom was touched, by 0.5 %."""


def drifting(count: int = 8) -> list[tuple[Calibration, LogEntry]]:
    """Calibrations a day apart, with their entries."""
    (capture,) = random_captures(np.random.default_rng(3), 1, count=100)
    device = DeviceSigmas((0.6, 0.6), (0.8, 0.9), (1e-3,) * 5)
    sigmas = Sigmas(device, device, (0.004, 0.004, 0.002), 0.01)
    truth = replace(capture.calibration, sigma=sigmas)
    found = []
    for day in range(count):
        warm = 1 - np.exp(-day / 2)
        zoom = 1 + (0.005 if day >= TOUCHED else 0.0)
        fx = truth.projector.focal_px[0] * zoom
        turn = rotation_about(np.radians([0.05 * warm, 0.01 * warm, 0.0]))
        centre = truth.projector.principal_point_px
        projector = replace(truth.projector, focal_px=(fx, fx), principal_point_px=(centre[0], centre[1] + 1.5 * warm))
        pose = Pose(turn @ truth.pose.rotation, truth.pose.translation)
        calibration = replace(truth, projector=projector, pose=pose)
        entry = entry_for(calibration, BEGUN + timedelta(days=day))
        if day:
            said = f"A change of {ZOOMED} by 0.5 % ± 0.0004 % explains it." if day == TOUCHED else HOLDS
            more = {"holds": day != TOUCHED, "change": said, "captures": ["scans/check"], "kept": f"rig-{day}.yaml"}
            entry = entry.model_copy(update=more)
        found.append((calibration, entry))
    return found


def write_logged(folder: Path, count: int = 8) -> Path:
    """A calibration with its log in a folder; returns the calibration."""
    file = folder / "rig.yaml"
    found = drifting(count)
    write_calibration(file, found[-1][0])
    log_of(file).write_text(log_text([entry for _, entry in found]), encoding="utf-8")
    return file
