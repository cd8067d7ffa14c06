"""The paper's tables and figures from simulated captures, with its own figures beside them, as docs/results.md.

    python benchmarks/bench_paper.py                                     all of it, an hour or two
    python benchmarks/bench_paper.py --quick                             small pictures; the page goes to build/paper/
    python benchmarks/bench_paper.py --only table1 figure7 --rooms 2     some of it, then the page of what there is
    python benchmarks/bench_paper.py --missing                           go on where it was broken off
    python benchmarks/bench_paper.py --page                              the page again, of what was measured before

Each part is kept as it comes in benchmarks/paper/results/ (JSON). Decoded captures are kept in build/paper/, and taken
from there by all experiments. COLMAP's rows need pycolmap: pip install -e '.[bench]'.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

from colmap_two_view import HAS_COLMAP
from paper.captures import FULL, PROJECTOR, QUICK, Setup
from paper.curves import BEYOND
from paper.experiment import Results, run
from paper.page import write_page
from paper.photographs import PHOTOGRAPHS
from paper.sphere import SPHERE
from paper.tables import TABLES

ROOT = Path(__file__).parents[1]
SCRATCH = ROOT / "build" / "paper"
EXPERIMENTS = {experiment.name: experiment for experiment in (*TABLES, SPHERE, PHOTOGRAPHS, BEYOND)}
ROOMS = (0, 1, 2, 3)


@dataclass(frozen=True)
class Places:
    """Where results are kept, and where the page with its pictures goes."""

    results: Path
    page: Path
    images: Path


FOR_GOOD = Places(
    ROOT / "benchmarks" / "paper" / "results", ROOT / "docs" / "results.md", ROOT / "docs" / "images" / "results"
)
FOR_A_LOOK = Places(SCRATCH / "quick-results", SCRATCH / "results.md", SCRATCH / "images" / "results")


def main() -> None:
    options = _options()
    places = FOR_A_LOOK if options.quick else FOR_GOOD
    setup = Setup(
        ROOMS[: options.rooms], QUICK if options.quick else FULL, PROJECTOR, options.scratch, quick=options.quick
    )
    results = Results(places.results)
    for name in () if options.page else options.only:
        experiment = EXPERIMENTS[name]
        if experiment.needs_colmap and not HAS_COLMAP:
            print(f"{name}: left out, pycolmap is not installed (pip install -e '.[bench]')")
            continue
        run(experiment, setup, results, only_missing=options.missing)
    write_page(places.page, places.images, results)
    print(f"written: {places.page}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=EXPERIMENTS, default=list(EXPERIMENTS), metavar="NAME")
    parser.add_argument("--rooms", type=int, choices=range(1, len(ROOMS) + 1), default=len(ROOMS), help="how many")
    parser.add_argument("--quick", action="store_true", help="small pictures, few corners")
    parser.add_argument("--missing", action="store_true", help="measure only what is not there")
    parser.add_argument("--page", action="store_true", help="measure nothing, write the page")
    parser.add_argument("--scratch", type=Path, default=SCRATCH, metavar="DIR", help="where decoded captures are kept")
    return parser.parse_args()


if __name__ == "__main__":
    main()
