"""Response time of the command when there is nothing to do, compared with Python itself in the same run.

    python benchmarks/bench_startup.py

Help, a mistyped option and a mistyped command load nothing but the command line; the limit is 0.3 s.
"""

import argparse
import statistics
import subprocess
import sys
import time

LIMIT_S = 0.3
ANSWERS = {
    "python -c pass": ["-c", "pass"],
    "scan --help": ["-m", "scanner", "--help"],
    "scan replay --help": ["-m", "scanner", "replay", "--help"],
    "scan --confg room.yaml": ["-m", "scanner", "--confg", "room.yaml"],
    "scan replai": ["-m", "scanner", "replai"],
}


def seconds(arguments: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], capture_output=True, check=False)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=9)
    options = parser.parse_args()
    # Alternating, so that other load affects all of them.
    rounds = [{name: seconds(arguments) for name, arguments in ANSWERS.items()} for _ in range(options.repeat)]
    print(f"{'':24} {'median':>8} {'worst':>8} {'x python':>9} {'of limit':>9}")
    python = statistics.median(each["python -c pass"] for each in rounds)
    for name in ANSWERS:
        times = [each[name] for each in rounds]
        median = statistics.median(times)
        print(f"{name:24} {median:6.3f} s {max(times):6.3f} s {median / python:9.1f} {median / LIMIT_S:9.0%}")


if __name__ == "__main__":
    main()
