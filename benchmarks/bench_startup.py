"""Response time of the command when there is nothing to do, compared with Python itself in the same run.

    python benchmarks/bench_startup.py

Help and a mistyped word load nothing but the command line, a wrong path nothing that computes, a wrong key only what
reads configurations; the limit is 0.3 s. What all jobs load takes 0.7 s of a processor at most.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

LIMIT_S, JOBS_LIMIT_S = 0.3, 0.7
BARE = ("-c", "pass")
WRONG_KEY = "camera: {widht: 640, height: 480}\n"
JOBS = "import scanner.jobs"


@dataclass(frozen=True)
class Spent:
    """What a process took, with one thread for linear algebra, as commands have."""

    clock_s: float
    """On the wall."""
    processor_s: float
    """Of all processors."""

    @classmethod
    def by(cls, arguments: tuple[str, ...]) -> "Spent":
        """Of Python with these arguments."""
        before, start_s = _of_children_s(), time.perf_counter()
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, check=False)
        return cls(time.perf_counter() - start_s, _of_children_s() - before)


def _of_children_s() -> float:
    """Processor seconds of all processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def answers(wrong: Path) -> dict[str, tuple[str, ...]]:
    """What is asked of Python, by name; `wrong` is a configuration with a wrong key."""
    command = ("-m", "scanner")
    return {
        "python -c pass": BARE,
        "scan --help": (*command, "--help"),
        "scan replay --help": (*command, "replay", "--help"),
        "scan --confg room.yaml": (*command, "--confg", "room.yaml"),
        "scan replai": (*command, "replai"),
        "scan replay nowhere": (*command, "replay", "nowhere"),
        "scan --config (wrong key)": (*command, "--config", str(wrong)),
        JOBS: ("-c", JOBS),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=9)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wrong = Path(folder) / "room.yaml"
        wrong.write_text(WRONG_KEY, encoding="utf-8")
        asked = answers(wrong)
        # Alternating, so that other load affects all of them.
        rounds = [{name: Spent.by(arguments) for name, arguments in asked.items()} for _ in range(options.repeat)]
    print(f"{'':26} {'median':>8} {'worst':>8} {'processor':>10} {'x python':>9} {'of limit':>9}")
    python = statistics.median(spent["python -c pass"].clock_s for spent in rounds)
    for name in asked:
        clock_s = [spent[name].clock_s for spent in rounds]
        median, processor_s = statistics.median(clock_s), statistics.median(spent[name].processor_s for spent in rounds)
        of_limit = processor_s / JOBS_LIMIT_S if name == JOBS else median / LIMIT_S
        times = f"{median:6.3f} s {max(clock_s):6.3f} s {processor_s:8.3f} s"
        print(f"{name:26} {times} {median / python:9.1f} {of_limit:9.0%}")


if __name__ == "__main__":
    main()
