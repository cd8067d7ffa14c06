"""Boards and corners of one synthetic rig, for tests that combine them."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from calib.boards import Board, BoardCalibration, calibrate_boards, rig_uncertainty
from calib.diagnostics import SystematicErrors
from calib.geometry import Calibration, Matches
from calib.numerics import Floats
from calib.self_calibration import KnownCalibration, PrincipalPoint, SelfCalibration, self_calibrate_jointly
from calib.synthetic import random_boards, random_captures
from tests.support.boards import views_of


@dataclass(frozen=True)
class Before:
    """`boards` with their estimate, `known`; the matches of the `corner`; `truth` of the rig, in metres."""

    truth: Calibration
    boards: BoardCalibration
    known: KnownCalibration
    corner: Matches

    @property
    def guess(self) -> PrincipalPoint:
        camera = self.truth.camera
        return PrincipalPoint(((camera.width - 1) / 2, (camera.height - 1) / 2), 0.03 * camera.width)

    def joint(self) -> SelfCalibration:
        sizes = self.truth.camera.size, self.truth.projector.size
        (found,) = self_calibrate_jointly([self.corner], *sizes, principal_point=self.guess, known=self.known)
        return found


@cache
def before(seed: int, **changes: Any) -> Before:
    rng = np.random.default_rng(seed)
    rig, found, known = from_boards(rng, views=4, matches=2000, **changes)
    return Before(rig, found, known, corner_before(rng, rig))


def from_boards(
    rng: np.random.Generator, *, views: int, matches: int, **changes: Any
) -> tuple[Calibration, BoardCalibration, KnownCalibration]:
    """A synthetic rig, and its calibration from flat boards."""
    boards = random_boards(rng, views=views, matches=matches, bend=0.0, **changes)
    rig = boards.calibration
    sizes = rig.camera.size, rig.projector.size
    found = calibrate_boards(views_of(boards), *sizes, Board(boards.reach, 2, "m"))
    return rig, found, KnownCalibration(found.calibration, rig_uncertainty(found.estimate, sizes))


def corner_before(rng: np.random.Generator, rig: Calibration, zoom: float = 1.0) -> Matches:
    """A capture of a corner by the rig, with its projector's focal length multiplied by `zoom`."""
    focal = zoom * rig.projector.focal_px[0]
    (capture,) = random_captures(
        rng,
        1,
        rig=rig,
        camera=rig.camera,
        projector=replace(rig.projector, focal_px=(focal, focal)),
        count=20_000,
        distance=(1.0, 2.0),
        walls_off_deg=0.3,
    )
    return capture.matches


def errors_of(known: KnownCalibration) -> SystematicErrors:
    calibration = known.calibration
    sigma = (calibration.sigma.known_baseline or 0.0) / calibration.baseline
    return SystematicErrors.of(calibration, known.uncertainty, sigma)


def intrinsics_and_length(calibration: Calibration) -> Floats:
    """Focal length and principal point of both devices, and the baseline, (7,)."""
    devices = (calibration.camera, calibration.projector)
    return np.array([*(x for d in devices for x in (d.focal_px[0], *d.principal_point_px)), calibration.baseline])


def sigmas(calibration: Calibration) -> Floats:
    """Sigmas of these parameters, (7,)."""
    own = calibration.sigma
    devices = (own.camera, own.projector)
    return np.array([*(x for d in devices for x in (d.focal_px[0], *d.principal_point_px)), own.known_baseline])
