"""Compare the results of two checkouts of this program.

    git worktree add ../before COMMIT
    python benchmarks/compare_results.py ../before . --seeds 0 1 2 --recordings captures/*

Both scan the same simulated rooms, once and from two poses, and replay the same recordings, also with the calibration
beside them. Output, exit codes, and the numbers and words in calibration.yaml, matches.npz and the clouds are compared;
files that only one of them writes are listed. Exit code 1 if anything differs.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

_PLY_TYPES = {"float": "<f4", "uchar": "u1", "int": "<i4"}
_SMALL = (
    "camera={width: 408, height: 342, principal_point: {known: [209.0, 175.3]}}",
    "projector={width: 427, height: 240}",
    "sequence.preset=quick",
    "rig.walls_off_deg=0",
    "corner.squareness_deg=0",
)


def commands(seeds: list[int], recordings: list[Path], results: Path) -> Iterator[tuple[str, list[str]]]:
    """Commands by name; each checkout uses its own configuration, `results` are those of the first checkout."""
    room = ["--config", "configs/room-sim.yaml", *(word for key in _SMALL for word in ("--set", key))]
    for seed in seeds:
        one = [*room, "--set", f"rig.seed={seed}"]
        yield f"room {seed}", one
        yield f"room {seed}, twice", [*one, "--captures", "2", "--set", "corner.squareness_deg=0.3"]
        yield f"room {seed}, paper", [*one, "--set", "method=paper"]
        yield f"room {seed}, from its matches", ["calibrate", str(results / _folder(f"room {seed}, twice")), *one]
    for recording in recordings:
        yield recording.name, ["replay", str(recording)]
        if (recording / "calibration.yaml").is_file():
            given = ["--calibration", str(recording / "calibration.yaml")]
            yield f"{recording.name}, calibrated", ["replay", str(recording), *given]


def _folder(name: str) -> str:
    return name.replace(", ", "-").replace(" ", "-")


def run(checkout: Path, arguments: list[str], out: Path) -> tuple[int, list[str]]:
    """Exit code, and the output without paths and times."""
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    done = subprocess.run(
        [sys.executable, "-m", "scanner", *arguments, "--out", str(out), "--quiet"],
        cwd=checkout,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, (done.stdout + done.stderr).replace(str(out), "OUT").splitlines()


def differences(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    """Differences of the files of two result folders, as sentences."""
    files = [{str(path.relative_to(each)) for path in each.rglob("*") if path.is_file()} for each in (before, after)]
    for name in sorted(files[0] ^ files[1]):
        yield f"{name} is only {'before' if name in files[0] else 'after'}"
    for name in sorted(files[0] & files[1]):
        read = _READERS.get(Path(name).suffix)
        if read is None or Path(name).name == "capture.yaml":
            continue
        first, second = read(before / name), read(after / name)
        for key in sorted(first.keys() | second.keys()):
            if key not in first or key not in second:
                yield f"{name}: {key} is only {'before' if key in first else 'after'}"
            elif isinstance(first[key], str) or isinstance(second[key], str):
                yield from (f"{name}: {change}" for change in _changes(str(first[key]), str(second[key])))
            else:
                off = _off(first[key], second[key])
                if off > tolerance:
                    yield f"{name}: {key} differs by {off:.2g} of its size"


def _off(first: Any, second: Any) -> float:
    """The largest difference of two arrays, relative to their largest value; infinite for different shapes."""
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if a.shape != b.shape or np.any(np.isnan(a) != np.isnan(b)):
        return float("inf")
    return float(np.nanmax(np.abs(a - b), initial=0.0) / max(np.nanmax(np.abs(a), initial=0.0), 1e-300))


def _changes(first: str, second: str) -> Iterator[str]:
    """The differing words of a text."""
    words = first.split(), second.split()
    for kind, begin, end, new, until in SequenceMatcher(None, *words, autojunk=False).get_opcodes():
        if kind != "equal":
            yield f"“{' '.join(words[0][begin:end])}” is now “{' '.join(words[1][new:until])}”"


def _yaml(path: Path) -> dict[str, Any]:
    return dict(_leaves(yaml.safe_load(path.read_text(encoding="utf-8")), ""))


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}.{key}".lstrip("."))
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        for number, inner in enumerate(value):
            yield from _leaves(inner, f"{name}.{number}")
    elif isinstance(value, list) and any(isinstance(each, str) for each in value):
        yield name, "\n".join(map(str, value))
    else:
        yield name, value


def _npz(path: Path) -> dict[str, Any]:
    with np.load(path) as arrays:
        return dict(arrays)


def _ply(path: Path) -> dict[str, Any]:
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    fields = [(line.split()[2], _PLY_TYPES[line.split()[1]]) for line in lines if line.startswith("property")]
    vertices: NDArray[np.void] = np.frombuffer(body, np.dtype(fields))
    return {"comments": "\n".join(line for line in lines if line.startswith("comment"))} | {
        name: vertices[name] for name, _ in fields
    }


def _html(path: Path) -> dict[str, Any]:
    """The words of a report."""
    text = re.sub(r"<(style|script)\b.*?</\1>|<[^>]*>", " ", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    return {"words": " ".join(text.split())}


_READERS = {".yaml": _yaml, ".npz": _npz, ".ply": _ply, ".html": _html}


def main() -> int:
    """Compare, and print the differences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="a checkout")
    parser.add_argument("after", type=Path, help="another")
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1], help="simulated rooms")
    parser.add_argument("--recordings", type=Path, nargs="*", default=[], metavar="CAPTURE", help="to replay")
    parser.add_argument("--tolerance", type=float, default=1e-6, help="of a number's size (default: 1e-6)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="leave the results there")
    args = parser.parse_args()
    found = 0
    with tempfile.TemporaryDirectory() as temporary:
        place = (args.keep or Path(temporary)).resolve()
        for name, arguments in commands(args.seeds, [path.resolve() for path in args.recordings], place / "before"):
            folders = [place / side / _folder(name) for side in ("before", "after")]
            ended = [
                run(checkout.resolve(), arguments, out)
                for checkout, out in zip((args.before, args.after), folders, strict=True)
            ]
            report = [f"exit code {code}" for code, _ in ended] if ended[0][0] != ended[1][0] else []
            report += [f"before: {line}" for line in ended[0][1] if line not in ended[1][1]]
            report += [f"after:  {line}" for line in ended[1][1] if line not in ended[0][1]]
            if all(folder.is_dir() for folder in folders):
                report += differences(folders[0], folders[1], args.tolerance)
            found += len(report)
            print(f"{name} (exit code {ended[0][0]}): {'the same' if not report else ''}", flush=True)
            for line in report:
                print(f"    {line}", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
