"""The paper's tables and figures from simulated captures, beside the published ones, as docs/results.md.

    python benchmarks/bench_paper.py                                     all of it, an hour or two
    python benchmarks/bench_paper.py --quick                             small pictures; the page goes to build/paper/
    python benchmarks/bench_paper.py --only table1 figure7 --rooms 2     a part, then the page of all results
    python benchmarks/bench_paper.py --missing                           continue an interrupted run
    python benchmarks/bench_paper.py --page                              the page of earlier results

Each part is saved in benchmarks/paper/results/ (JSON) once it is measured. Decoded captures are saved in build/paper/
and shared by all experiments. COLMAP's rows need pycolmap: pip install -e '.[bench]'.
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
    """Folders of the results, and of the page with its pictures."""

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
