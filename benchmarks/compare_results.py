"""Compare the results of two checkouts of this program: a refactoring changes no number.

    git worktree add ../before COMMIT
    python benchmarks/compare_results.py ../before . --keep ../kept
    python benchmarks/compare_results.py ../before . --keep ../kept --only corner network

Both run the commands of `comparison/cases.py` side by side: simulated scans, rooms, things, networks, boards, photos,
films, live clouds, imports, exports, and refused ones of each; and replays of recordings. Exit codes, output and the
content of every file are compared, each number to 1e-9 of its size (`comparison/differences.py`), without what differs
in two runs of one program (`comparison/readers.py`). Exit code 1 if anything differs.

With --keep, the results of OLD are kept there for its commit, if it has no changes, and not made again; those of NEW
are there until it is compared again.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from comparison.cases import CASES, Case, recordings_in
from comparison.differences import folder_differences
from comparison.inputs import INPUTS
from comparison.running import EXIT_CODE, Checkout, Runs, kept_folder

_MOST = 12  # differences of a case that are printed


def main() -> int:
    """Compare, and print the differences."""
    args = _parser().parse_args()
    old, new = (Checkout(path.resolve()) for path in (args.old, args.new))
    every_case = CASES | recordings_in(args.recordings or [old.folder.parent / "shared" / "data"])
    if args.list:
        print("\n".join(f"{name:<28} scan {case.command}" for name, case in every_case.items()))
        return 0
    names = args.only or list(every_case)
    if unknown := sorted(set(names) - set(every_case)):
        sys.exit(f"no such case: {', '.join(unknown)}; --list names all")
    with tempfile.TemporaryDirectory() as temporary:
        place = (args.keep or Path(temporary)).resolve()
        kept = kept_folder(place, old) if args.keep else None
        folders = kept or Path(temporary) / "before", place / f"after-{new.folder.name}"
        runs = Runs((old, new), folders, every_case, INPUTS, args.jobs)
        try:
            futures = {name: runs.submit(name) for name in names}
            differing = 0
            for name, (before, after) in futures.items():
                report = list(_differences(every_case[name], before.result(), after.result(), args.tolerance))
                differing += bool(report)
                _show(name, report, len(report) if args.all else _MOST)
        finally:
            runs.close()
    print(f"{len(names)} cases, {differing} differ")
    return 1 if differing else 0


def _differences(case: Case, before: Path, after: Path, tolerance: float) -> Iterator[str]:
    if (code := (before / EXIT_CODE).read_text(encoding="utf-8")) != str(case.exit_code):
        yield f"exit code {code} before, where {case.exit_code} is expected: this case no longer tests what it is for"
    yield from folder_differences(before, after, tolerance)


def _show(name: str, report: list[str], most: int) -> None:
    print(f"{name}: {'differs' if report else 'the same'}", flush=True)
    for line in report[:most]:
        print(f"    {line}")
    if report[most:]:
        print(f"    and {len(report) - most} more (--all shows them)", flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, metavar="OLD", help="a checkout")
    parser.add_argument("new", type=Path, metavar="NEW", help="another")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the results there")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these cases, and what they need of OLD")
    parser.add_argument("--list", action="store_true", help="print the cases, and run none")
    parser.add_argument("--recordings", type=Path, nargs="*", metavar="CAPTURE", help="to replay, also in folders")
    parser.add_argument("--tolerance", type=float, default=1e-9, help="of a number's size (default: 1e-9)")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count(), metavar="N", help="side by side (default: processors)"
    )
    parser.add_argument("--all", action="store_true", help=f"print all differences of a case, not only {_MOST}")
    return parser


if __name__ == "__main__":
    sys.exit(main())
