"""Outcomes → a table with a row per condition and strength, and the two totals."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from conditions.catalogue import conditions
from conditions.judging import MOST_PERCENT, MOST_SIGMAS
from conditions.trial import Outcome

BEGIN, END = "<!-- conditions: begin, written by benchmarks/bench_conditions.py --write -->", "<!-- conditions: end -->"

_COLUMNS = (
    "condition",
    "strength",
    "exit codes",
    "lit pixels matched",
    "match error, px: median, 99 %",
    "calibration error, %: rms, worst",
    "in sigmas: rms, worst",
    "grade",
    "refused, could be decoded",
    "confident and wrong",
)


def refused_needlessly(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """Captures that were refused although a plain decoder decodes them; mistakes may always be refused."""
    faults = {(c.name, c.strength) for c in conditions() if c.fault}
    return [o for o in outcomes if o.exit_code != 0 and o.decodable and (o.name, o.strength) not in faults]


def confident_and_wrong(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """Captures with a wrong answer, except the `admitted` ones."""
    accepted = admitted(outcomes := list(outcomes))
    return [o for o in outcomes if o.wrong and o not in accepted]


def admitted(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """Answers more than 2 % off with a sufficient sigma: within 4 sigma of the truth, and graded as a first look only.

    A correctly stated uncertainty, with the advice to capture again, is not confidence.
    """
    return [
        o for o in outcomes if o.wrong and o.grade == "fair" and o.sigmas and _worst(np.array(o.sigmas)) <= MOST_SIGMAS
    ]


def markdown(outcomes: Sequence[Outcome]) -> str:
    """The table and its totals."""
    by_row = defaultdict(list)
    for outcome in outcomes:
        by_row[outcome.name, outcome.strength].append(outcome)
    lines = [_line(_COLUMNS), _line(["---"] * len(_COLUMNS))]
    lines += [_row(by_row[c.name, c.strength]) for c in conditions() if (c.name, c.strength) in by_row]
    rooms, sequences = sorted({o.seed for o in outcomes}), Counter(o.sequence for o in outcomes)
    counted = ", ".join(f"{sequence} × {count}" for sequence, count in sequences.items())
    measured = f"{len(outcomes)} captures, rooms {', '.join(map(str, rooms))}, sequences {counted}."
    return "\n".join([*lines, "", measured, "", *_totals(outcomes)])


def write_into(page: Path, text: str, *, rows_alone: bool = False) -> None:
    """Insert a text between the marks of a page, or only the rows of its table into the existing table."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    there, _, after = rest.partition(END)
    text = _with_rows(there.strip(), text) if rows_alone else text
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


def _with_rows(there: str, text: str) -> str:
    """A text with a table, whose rows of the same captures are replaced by those of another table."""
    table, _, totals = there.partition("\n\n")
    rows = {_key(line): line for part in (table, text.partition("\n\n")[0]) for line in part.splitlines()[2:]}
    known = [row for c in conditions() if (row := rows.get((c.name, c.strength)))]
    return "\n".join([*table.splitlines()[:2], *known, "", totals])


def _key(row: str) -> tuple[str, str]:
    name, strength = row.split("|")[1:3]
    return name.strip(), strength.strip()


def _row(outcomes: Sequence[Outcome]) -> str:
    codes = Counter(o.exit_code for o in outcomes)
    grades = Counter(o.grade for o in outcomes if o.exit_code == 0)
    return _line(
        [
            outcomes[0].name,
            outcomes[0].strength,
            ", ".join(f"{code} × {number}" if len(codes) > 1 else f"{code}" for code, number in sorted(codes.items())),
            _over(outcomes, lambda o: o.matched, np.mean, "{:.1%}"),
            _pair(outcomes, (lambda o: o.match_median_px, np.mean), (lambda o: o.match_99_px, np.mean), "{:.2f}"),
            _pair(outcomes, (lambda o: o.percent, _rms), (lambda o: o.percent, _worst), "{:.2f}"),
            _pair(outcomes, (lambda o: o.sigmas, _rms), (lambda o: o.sigmas, _worst), "{:.1f}"),
            ", ".join(f"{grade} × {number}" for grade, number in sorted(grades.items())) or "–",
            str(len(refused_needlessly(outcomes)) or "–"),
            str(len(confident_and_wrong(outcomes)) or "–"),
        ]
    )


def _totals(outcomes: Sequence[Outcome]) -> list[str]:
    moving = {(c.name, c.strength) for c in conditions() if c.moves}
    lines = []
    for title, those in (
        ("Devices at rest", [o for o in outcomes if (o.name, o.strength) not in moving]),
        ("Devices that move", [o for o in outcomes if (o.name, o.strength) in moving]),
    ):
        if those:
            lines.append(
                f"{title}, {len(those)} captures: **{len(refused_needlessly(those))} refused that could be decoded, "
                f"{len(confident_and_wrong(those))} confident and wrong**; {len(admitted(those))} more are off by over "
                f"{MOST_PERCENT:g} % and say so, being within {MOST_SIGMAS:g} sigma and graded as a first look only."
            )
            lines.append("")
    return lines[:-1]


Figure = Callable[[Outcome], "float | tuple[float, ...] | None"]
Summary = Callable[[np.ndarray], float]


def _pair(outcomes: Sequence[Outcome], first: tuple[Figure, Summary], second: tuple[Figure, Summary], form: str) -> str:
    shown = [_over(outcomes, figure, summary, form) for figure, summary in (first, second)]
    return "–" if shown[0] == "–" else ", ".join(shown)


def _over(outcomes: Sequence[Outcome], figure: Figure, summary: Summary, form: str) -> str:
    values = [np.atleast_1d(value) for o in outcomes if (value := figure(o)) is not None]
    return form.format(summary(np.concatenate(values))) if values else "–"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _worst(values: np.ndarray) -> float:
    return float(np.abs(values).max())


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
