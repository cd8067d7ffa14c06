"""Texts of the page, as Markdown and HTML."""

import time
from collections.abc import Iterable, Mapping
from datetime import datetime

from markupsafe import escape

from scanner.checking import CheckRow, CheckState
from scanner.console.progress import ProgressStep
from scanner.console.results import Card
from scanner.console.worker import Status
from scanner.networks import PairProgress
from scanner.results import SIGNS
from scanner.shown_text import harmless, shortened
from scanner.viewing import bold, escaped

_SIGNS = {CheckState.OK: "✓", CheckState.POOR: "!", CheckState.FAILED: "✗"}
_WORTH_TELLING_S = 5.0


def status_text(status: Status) -> str:
    """Describe the current activity, or how the last one ended."""
    if status.message:
        return bold(status.message)
    if status.question:
        return f"**{escaped(status.question)}.**"
    if status.cancelling:
        return f"**{status.activity}**: stopping after the present step …"
    if status.stage is None:
        return f"**{status.activity}**"
    time_left = _time_text(status.stage) if status.busy else ""
    return f"**{status.activity}**: {escaped(stage_text(status.stage))}{time_left}"


def stage_text(stage: ProgressStep) -> str:
    """What is being done, and how much of it is."""
    return stage.what + (f", {stage.done} of {stage.total}" if stage.total else "")


def stages_html(stages: Iterable[ProgressStep], *, timed: bool) -> str:
    """Bars of what is done one after the other, with the time left if `timed`."""
    return "".join(
        f'<div class="scan-stage"><p>{escape(_stage_words(stage, timed=timed))}</p><progress aria-label='
        f'"{escape(stage.what)}" max="{stage.total}" value="{stage.done}"></progress></div>'
        for stage in stages
    )


def _stage_words(stage: ProgressStep, *, timed: bool) -> str:
    if stage.done == stage.total:
        return f"{stage.what}: done"
    if not stage.done:
        return f"{stage.what}: waiting"
    return f"{stage_text(stage)} frames{_time_text(stage) if timed else ''}"


def pictures_html(pictures: Mapping[str, tuple[str, str]]) -> str:
    """Small pictures of cameras by their names, each a caption and a data URI."""
    figures = (
        f'<figure><img alt="what {escape(name)} sees" src="{uri}"><figcaption>{escape(caption)}</figcaption></figure>'
        for name, (caption, uri) in pictures.items()
    )
    return f'<div class="scan-pictures">{"".join(figures)}</div>'


def failures_html(sights: Iterable[PairProgress]) -> str:
    """Why there is no capture of a network's cameras."""
    return "".join(
        f'<p class="scan-link">{escape(f"{sight.name} {sight.text}")}</p>' for sight in sights if sight.failure
    )


def _time_text(stage: ProgressStep) -> str:
    """Return the remaining time or, where it is unknown, the elapsed time; '' during the first moment."""
    now_s = time.monotonic()
    left_s = stage.left_s(now_s)
    if left_s is None:
        elapsed_s = now_s - stage.began_s
        return f", {_duration(elapsed_s)} so far" if elapsed_s >= _WORTH_TELLING_S else ""
    worth = left_s + now_s - stage.began_s >= _WORTH_TELLING_S
    return f", about {_duration(left_s)} left" if worth else ""


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def guidance_text(guidance: tuple[str, ...]) -> str:
    """Return the message to the operator between captures."""
    return "\n".join(f"- {escaped(sentence)}" for sentence in guidance)


def rows_text(rows: list[CheckRow]) -> str:
    """The check's findings, and what to do about them."""
    lines = []
    for row in rows:
        lines.append(
            f"- **{_SIGNS[row.state]} {escaped(row.name)}**, {row.state.value}: {escaped(row.finding.message)}"
        )
        if row.finding.advice:
            lines.append(f"  → {escaped(row.finding.advice)}")
    return "\n".join(lines)


def grade_text(rows: list[CheckRow]) -> str:
    """Return the overall grade of a check."""
    failed, poor = (sum(row.state is state for row in rows) for state in (CheckState.FAILED, CheckState.POOR))
    if failed:
        return f"**✗ A scan would fail**: {failed} of {len(rows)} lines say why."
    if poor:
        return f"**! A scan works, but could be better**: {poor} of {len(rows)} lines say how."
    return f"**✓ Ready to scan**: all {len(rows)} lines are good."


_SHOWN_OF_NOTE = 160


def card_html(card: Card, *, chosen: bool = False) -> str:
    """A result in the history: its picture, name, date, grade and note; the one that is chosen has a frame."""
    when = datetime.fromtimestamp(card.made_s).astimezone()
    picture = f'<img src="{card.picture}" alt="what the camera saw">' if card.picture else '<div class="none"></div>'
    verdict = f"{SIGNS[card.grade]} {card.headline}" if card.grade else "no verdict"
    note = shortened(harmless(card.note.strip()), _SHOWN_OF_NOTE)
    kind = "scan-card scan-chosen" if chosen else "scan-card"
    return (
        f'<div class="{kind}">{picture}<div><p><strong>{escape(harmless(card.name))}</strong></p>'
        f"<p>{escape(verdict)}</p><p class='scan-quiet'>{when:%Y-%m-%d, %H:%M}</p>"
        f"{f'<p class=scan-note>{escape(note)}</p>' if note else ''}</div></div>"
    )
