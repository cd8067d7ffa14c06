"""Robustness against imperfect captures: light, lenses, motion, pictures, files.

    python benchmarks/bench_conditions.py --quick            one room, the standard sequence: some minutes
    python benchmarks/bench_conditions.py --jobs 2 --write   all of it, an hour or two; writes conditions/results.md
    python benchmarks/bench_conditions.py --only flicker --seeds 3 --sequences gray -v

Each capture is of a simulated room, written as a capture folder, and replayed through the command line in this process.
The principal point is given, and the walls are square and known to be. Two totals matter:

- *refused that could be decoded*: the exit code is not 0, but the matches of a plain decoder without checks
  (`conditions/plain_decoder.py`: a bit against its inverse, or half-way between white and black; fringes by least
  squares; at most three of the finest bits left out) have a median error of at most 0.5 px, and calibrating with
  them errs by at most 4 sigma or by at most 2 %;
- *confident and wrong*: the exit code is 0, and one of f_c, f_p, x_p, y_p errs by more than 4 sigma; or by more than
  2 % where the report does not say that the result is good for a first look only. With patterns along one axis, for
  which the true calibration is given: the matches err by more than 2 sigma in the median.

Mistakes (exchanged frames, a wrong size) may always be refused. If no pinhole with square pixels explains the picture,
only the camera's focal length is judged.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import product
from multiprocessing import get_context
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
from conditions.captures import SEQUENCES
from conditions.catalogue import Condition, conditions
from conditions.table import confident_and_wrong, markdown, refused_needlessly, write_into
from conditions.trial import Outcome, Setup, named, run

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "benchmarks" / "conditions" / "results.md"


def main() -> None:
    options = _options()
    chosen = [c for c in conditions() if any(text in f"{c.name} {c.strength}" for text in options.only)]
    seeds, sequences = ([0], ["standard"]) if options.quick else (options.seeds, options.sequences)
    setups = [Setup(*which, tuple(options.camera), tuple(options.projector)) for which in product(seeds, sequences)]
    outcomes = [*_earlier(options.results)]
    done = {(o.name, o.strength, o.seed, o.sequence) for o in outcomes}
    tasks = [
        (c.name, c.strength, s, options.keep)
        for s in setups
        for c in chosen
        if (c.name, c.strength, s.seed, s.sequence) not in done
        # Conditions with their own patterns do not depend on the sequence.
        if c.shown is None or s.sequence == sequences[0]
    ]
    # Workers are started, not forked, because threads of a library do not survive a fork.
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        for outcome in pool.map(_run, tasks, chunksize=4):
            outcomes.append(outcome)
            _tell(outcome, len(outcomes), len(tasks) + len(done), verbose=options.verbose)
            if options.results:
                with options.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(outcome)) + "\n")
    text = markdown(outcomes)
    print(text)
    if options.write:
        write_into(PAGE, text, rows_alone=options.only != [""])


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="rooms")
    parser.add_argument("--sequences", nargs="+", choices=SEQUENCES, default=list(SEQUENCES))
    parser.add_argument(
        "--only", nargs="+", default=[""], metavar="TEXT", help="conditions with it in name or strength"
    )
    parser.add_argument("--quick", action="store_true", help="one room and one sequence")
    parser.add_argument("--camera", type=int, nargs=2, default=[612, 512])
    parser.add_argument("--projector", type=int, nargs=2, default=[427, 240])
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--results", type=Path, metavar="FILE", help="keep outcomes here, and go on where it ends")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep captures and results in this folder")
    parser.add_argument(
        "--write", action="store_true", help=f"write the table, or the rows chosen, into {PAGE.relative_to(ROOT)}"
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="say what came of each capture")
    return parser.parse_args()


def _run(task: tuple[str, str, Setup, Path | None]) -> Outcome:
    name, strength, setup, keep = task
    condition: Condition = named(name, strength)  # lambdas cannot be pickled
    return run(condition, setup, keep)


def _earlier(path: Path | None) -> Iterator[Outcome]:
    if path is None or not path.exists():
        return
    found = [Outcome(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    yield from {(o.name, o.strength, o.seed, o.sequence): o for o in found}.values()  # the last of several


def _tell(outcome: Outcome, number: int, of: int, *, verbose: bool) -> None:
    bad = "confident and wrong" if confident_and_wrong([outcome]) else ""
    bad = "refused, could be decoded" if refused_needlessly([outcome]) else bad
    if not (verbose or bad):
        return
    figures = "" if outcome.percent is None else f"{max(map(abs, outcome.percent)):.2f} %"
    of_matches = outcome.match_sigmas
    figures += "" if of_matches is None else f" matches {of_matches[0]:.1f} sigma, 90 % {of_matches[1]:.1f}"
    figures += "" if outcome.sigmas is None else f" {max(map(abs, outcome.sigmas)):.1f} sigma {outcome.grade}"
    about = f"{outcome.name} {outcome.strength}, room {outcome.seed}, {outcome.sequence}"
    print(f"{number}/{of} {about}: {outcome.exit_code} {figures} {bad} {outcome.message[:300]}", file=sys.stderr)


if __name__ == "__main__":
    main()
