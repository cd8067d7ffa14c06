"""The complete check. Rows are yielded as they are found, so that a page can show them one by one."""

import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

from calib.geometry import Size
from hw.errors import DeviceError
from hw.rig import Frame, Rig
from scanner.capture import capture
from scanner.checking import view
from scanner.checking.devices import device_rows, opened, transfer_rows
from scanner.checking.document import contrast_picture, coverage_picture, saturation_picture
from scanner.checking.exposure import exposure_row, propose_exposure
from scanner.checking.focus import LONG_PERIOD_PX, finest_period_px, focus_row, period_for, sample_blur, separate_lenses
from scanner.checking.fringes import STEPS, FringeMeter
from scanner.checking.light import Light, light_rows, photograph_light, settled
from scanner.checking.report import CheckReport, OnRow
from scanner.checking.response import measure_ramp, pixel_row, response_row
from scanner.checking.steadiness import InitialState, Levels, levels_of, patterns, steadiness_row
from scanner.configuration import Config
from scanner.decoding import MaskReason
from scanner.patterns import Pattern, phase_sequence
from scanner.reconstruction import read_captures
from scanner.results import Decoded
from scanner.ui import Progress

_WHITES, _BLACKS = 6, 4


def check_configured_rig(
    config: Config, terminal: Progress, on_row: OnRow | None = None, watch_s: float = 0.0
) -> CheckReport:
    """Open the configured rig and check it; `on_row` is called with each row as soon as it is known.

    Drift is looked for over `watch_s` seconds, or as long as the rest of the check takes.

    A device that fails is a row. Raises InputError if the configuration names no rig or no sizes, or if earlier
    captures that it names cannot be read.
    """
    with ExitStack() as devices:
        try:
            with terminal.step("Preparing the rig"):
                rig = devices.enter_context(opened(config))
        except DeviceError as error:
            report = CheckReport(on_row=on_row)
            report.fail(error)
            return report
        return check_rig(rig, config, terminal, on_row, watch_s)


def check_rig(
    rig: Rig, config: Config, terminal: Progress, on_row: OnRow | None = None, watch_s: float = 0.0
) -> CheckReport:
    """Check a rig that is open, as `check` does. Its camera is left at the exposure that is proposed."""
    earlier = read_captures(config.earlier, Size(*rig.camera.size), Size(*rig.projector.size))
    report = CheckReport(on_row=on_row)
    try:
        _check(_Bench(rig, config, terminal, earlier, watch_s), report)
    except DeviceError as error:
        report.fail(error)
    return report


@dataclass(frozen=True)
class _Bench:
    """What is checked, with the captures that a scan would be calibrated with, and for how long drift is looked for."""

    rig: Rig
    config: Config
    terminal: Progress
    earlier: list[Decoded]
    watch_s: float

    def show(self, patterns: Iterable[Pattern]) -> Iterator[tuple[Pattern, Frame]]:
        """Frames of patterns, sent as a scan would send them."""
        return capture(self.rig, tuple(patterns), response=self.config.projector.known_response).frames

    def fringes(self, light: Light, what: str) -> Levels:
        """What would show that something moved."""
        frames = settled(self.show, patterns(), light)
        return levels_of(self.terminal.track(frames, len(patterns()), what))


def _check(bench: _Bench, report: CheckReport) -> None:
    rig, terminal = bench.rig, bench.terminal
    report.add(*device_rows(rig))
    with terminal.step("Trying exposures"):
        proposal = propose_exposure(rig)
    report.exposure_us = proposal.exposure_us
    report.add(exposure_row(proposal, rig.refresh_hz, bracketed=bool(bench.config.sequence.exposures_us)))
    with terminal.step("Looking at light and dark"):
        light = photograph_light(rig, _WHITES, _BLACKS)
        ramp = measure_ramp(rig, light)
    report.pictures["saturation"] = saturation_picture(light)
    report.add(*light_rows(light))
    if ramp is None:
        report.add(view.nothing_lit())
        report.failure = view.refusal_of(report.rows[-1])
        return
    report.response = ramp.response.light if ramp.response else None
    report.add(response_row(ramp))
    with terminal.step("Looking at lines of one pixel"):
        row = pixel_row(rig, bench.config.projector.grid, light, ramp)
    report.add(*([row] if row else []))
    _check_view(bench, light, report)


def _check_view(bench: _Bench, light: Light, report: CheckReport) -> None:
    """Check the view from a quick capture. If that is refused or patchy, take the configured one, which is slower."""
    rig, config, terminal = bench.rig, bench.config, bench.terminal
    meter = FringeMeter()
    before = InitialState(time.monotonic(), light, bench.fringes(light, "Looking at stripes"))
    quick = view.take_quick(rig, config, meter, terminal)
    report.add(*transfer_rows(rig))
    with terminal.step("Calibrating"):
        row, failure = view.view_row(quick, config, bench.earlier)
    scanned = view.take_configured(rig, config, terminal) if failure or quick.is_patchy else None
    if scanned:
        with terminal.step("Calibrating"):
            row, failure = view.view_row(scanned, config, bench.earlier, as_configured=True)
    decoded = next((capture for capture in (scanned, quick) if capture and capture.decoding), None)
    decoded = decoded or view.take_coarse(rig, config, terminal)
    _check_lenses(bench, light, decoded, meter, report)
    _check_steadiness(bench, before, quick, report)
    report.add(row)
    report.failure = failure


def _check_steadiness(bench: _Bench, before: InitialState, quick: view.Capture, report: CheckReport) -> None:
    if not quick.decoding:
        return
    with bench.terminal.step("Waiting to see whether anything drifts"):
        time.sleep(max(0.0, bench.watch_s - (time.monotonic() - before.since_s)))
    now = bench.fringes(before.light, "Looking at the same stripes again")
    row = steadiness_row(bench.rig, before, now, view.projector_map(quick.decoding))
    report.add(*([row] if row else []))


def _check_lenses(bench: _Bench, light: Light, decoded: view.Capture, meter: FringeMeter, report: CheckReport) -> None:
    """Coverage and focus, from the projector pixels of each camera pixel and from more fringes for `meter`."""
    size = bench.rig.projector.size
    coverage = view.coverage_of(decoded.decoding, size) if decoded.decoding else None
    fringes = _more_fringes({period_for(coverage.span if coverage else 1.0), LONG_PERIOD_PX})
    for _ in bench.terminal.track(meter.watch(bench.show(fringes)), len(fringes), "Looking at stripes"):
        pass
    usable = light.well_lit
    if decoded.decoding and coverage:
        matched = decoded.decoding.reasons == MaskReason.KEPT
        report.add(view.coverage_row(coverage, decoded.decoding))
        report.pictures["coverage"] = coverage_picture(light, matched)
        usable = matched & ~light.clipped
        samples = sample_blur(meter.fringes, usable, view.projector_map(decoded.decoding))
        finest_px = finest_period_px(bench.config.sequence.patterns(size))
        report.add(focus_row(samples, separate_lenses(samples), finest_px))
    report.pictures["contrast"] = contrast_picture(meter.fringes, usable)


def _more_fringes(periods: set[float]) -> tuple[Pattern, ...]:
    patterns: list[Pattern] = []
    for period in sorted(periods):
        patterns += [*phase_sequence("x", period, STEPS), *phase_sequence("y", period, STEPS)]
    return tuple(patterns)
