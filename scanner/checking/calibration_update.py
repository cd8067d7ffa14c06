"""A calibration re-estimated from captures, with the earlier one as prior; both are kept, with a log over time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from calib.diagnostics import NOWHERE, RigChange, Uncertainty, moved_calibration, sigmas_of
from calib.finding import FindingKind
from calib.geometry import Calibration
from calib.numerics import Floats, inverse_of
from calib.refinement import KnownRig
from calib.refusal import RefusalError
from calib.scene import compare_with_lines
from calib.self_calibration import KnownCalibration
from scanner.checking.calibration_check import LINE_MATCHES, CalibrationCheck
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, new_files, write_calibration
from scanner.jobs import calibrate_captures, read_to_calibrate
from scanner.results import (
    KINDS,
    SelfCalibrated,
    calibration_file,
    covariance_entries,
    entry_for,
    log_of,
    log_text,
    read_log,
)
from scanner.ui import Terminal

_FREED = 10.0  # standard deviation of what has changed, in amounts of its change
_MOST_LEFT = 0.5  # of what rays missed each other by before

NOT_UPDATED = FindingKind(
    "not-updated",
    "The captures tell that a calibration has changed, but not to what: the file stays as it was.",
    "Take one capture of a corner, or three of anything from different sides, and update by these.",
    ("before_px", "after_px"),
)


@dataclass(frozen=True)
class CalibrationUpdate:
    """A calibration that took the place of another."""

    calibration: Calibration
    """The one in use now."""
    file: Path
    """Where it is."""
    kept: Path
    """Where the one before is."""
    log: Path
    """Where both are listed."""


def refuse_no_update(given: Path) -> None:
    """Raise InputError if a file is not one to be replaced: that of a result whose cloud was made with it."""
    folder = calibration_file(given).parent
    if any((folder / name).exists() for name in (MATCHES_FILE, *(kind.cloud for kind in KINDS))):
        raise InputError(
            f"{calibration_file(given)}: belongs to a result, whose cloud was made with it, and is not replaced: copy "
            "it, and give --calibration the copy"
        )


def update_calibration(
    given: Path, check: CalibrationCheck, captures: Sequence[Path], config: Config, folder: Path, terminal: Terminal
) -> CalibrationUpdate:
    """Re-estimate a calibration that was checked by `captures`, and put it in the file's place.

    The earlier calibration is the prior. If it does not hold, the parameter that explains the change is free. `folder`
    is for what comes between. Raises InputError; RefusalError, also if the estimate fits no better: then the file is
    as before.
    """
    refuse_no_update(given)
    file = calibration_file(given)
    if check.stated is None:
        raise InputError(
            f"{file}: states no covariance, without which it cannot be weighed against captures: calibrate the rig "
            "with scan board, or by captures alone"
        )
    calibration, uncertainty = _estimated(check, check.stated, captures, config, folder, terminal)
    _refuse_worse(check, calibration)
    date = datetime.now(UTC)
    kept = _unused(file, date)
    log = log_of(file)
    entries = read_log(log) or [entry_for(check.calibration, datetime.fromtimestamp(file.stat().st_mtime, UTC))]
    sources = [str(path) for path in captures]
    said = "The calibration holds." if check.holds else f"{check.change}."
    entries.append(entry_for(calibration, date, holds=check.holds, change=said, captures=sources, kept=kept.name))
    updated = {"date": date.isoformat(timespec="seconds"), "before": kept.name, "captures": sources, "found": said}
    before = file.read_bytes()
    with new_files(file.parent, [kept.name, log.name, file.name], overwrite=True) as (kept_part, log_part, part):
        kept_part.write_bytes(before)
        log_part.write_text(log_text(entries), encoding="utf-8")
        write_calibration(part, calibration, {"updated": updated, **covariance_entries(uncertainty)})
    return CalibrationUpdate(calibration, file, kept, log)


def _estimated(
    check: CalibrationCheck, stated: Uncertainty, captures: Sequence[Path], config: Config, folder: Path, tell: Terminal
) -> tuple[Calibration, Uncertainty]:
    prior = stated if check.holds else replace(stated, covariance=_freed(check.change, stated), along=NOWHERE)
    is_explained = check.holds or check.change.is_all
    if check.estimate is None:
        if not is_explained:
            raise RefusalError(NOT_UPDATED, f"{check.change}.", NOT_UPDATED.remedy)
        return _combined(check.calibration, prior, check.test.lines.step, check.test.lines.information)
    newest = check.estimate.newest
    assert newest.uncertainty is not None  # the check refuses methods without
    if not is_explained:
        return _in_unit_of(check.calibration, newest.calibration), newest.uncertainty
    if not isinstance(newest.calibrated, SelfCalibrated):
        step = KnownRig(prior.rig, prior.covariance).step_to(newest.uncertainty.rig)
        return _combined(check.calibration, prior, step, inverse_of(newest.uncertainty.covariance))
    # The likelihood of a corner is a curved valley, so its matches are fitted anew.
    path = folder / "prior.yaml"
    write_calibration(path, check.calibration, covariance_entries(prior))
    without_scale = config.model_copy(update={"scale": None})
    decoded, settings = read_to_calibrate([path, *captures], without_scale, tell)
    joint = calibrate_captures(decoded, settings, None, terminal=tell).newest
    assert joint.uncertainty is not None
    return _in_unit_of(check.calibration, joint.calibration), joint.uncertainty


def _freed(change: RigChange, stated: Uncertainty) -> Floats:
    """The covariance (21, 21) of what is known of a rig of which something has changed."""
    sigma = np.where(change.step == 0, 0.0, _FREED * np.linalg.norm(change.step))
    return stated.covariance + np.diag(sigma**2)


def _combined(
    given: Calibration, prior: Uncertainty, step: Floats, information: Floats
) -> tuple[Calibration, Uncertainty]:
    """The product of two Gaussians: a calibration's, and one with its mean at a step (21,) from it."""
    known = KnownCalibration(given, prior)
    covariance = inverse_of(known.rig.precision + information)
    moved = covariance @ (information @ step)
    uncertainty = Uncertainty(
        prior.rig.moved(moved),
        covariance,
        None,
        prior.match_px,
        with_log_baseline=known.with_log_baseline(covariance),
    )
    there = replace(moved_calibration(given, prior, moved).in_baselines, sigma=sigmas_of(uncertainty.state, covariance))
    return _in_unit_of(given, known.metric(there, uncertainty)), uncertainty


def _in_unit_of(given: Calibration, calibration: Calibration) -> Calibration:
    """A calibration in the unit of another, with its baseline where nothing was known of that."""
    if calibration.unit == given.unit:
        return calibration
    return calibration.scaled(given.baseline / calibration.baseline, given.unit)


def _refuse_worse(check: CalibrationCheck, calibration: Calibration) -> None:
    before_px = check.test.excess_px
    after = compare_with_lines(calibration, None, check.matches, LINE_MATCHES)
    after_px = after.excess_px
    if not after.holds and after_px > _MOST_LEFT * before_px:
        raise RefusalError(
            NOT_UPDATED,
            f"Under the new estimate rays still miss each other by {after_px:.2g} projector px more than at best, "
            f"under the earlier calibration by {before_px:.2g}.",
            NOT_UPDATED.remedy,
            {"before_px": before_px, "after_px": after_px},
        )


def _unused(file: Path, date: datetime) -> Path:
    """A free name for the calibration that was in use until a date."""
    stem = f"{file.stem}-until-{date:%Y-%m-%d-%H%M%S}"
    path, number = file.with_name(f"{stem}{file.suffix}"), 1
    while path.exists():
        number += 1
        path = file.with_name(f"{stem}-{number}{file.suffix}")
    return path
