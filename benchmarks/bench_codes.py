"""Gray and XOR codes, alone and together, under interreflection.

    python benchmarks/bench_codes.py [--bounced 0.5 2.5 4 8]

The synthetic scene of the decoder's tests, a box in front of a wall. Interreflection is the scene's light, blurred over
a fifth of the picture, as a multiple of the direct light. 'Wrong' matches are off by at least two projector px.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from scanner.decoding import MaskReason
from scanner.errors import InputError
from scanner.patterns import PRESETS, Code, PresetName

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.synthetic_capture import Scene

CODES: tuple[Code, ...] = ("gray", "xor", "both")
CELL_PX = 8
WRONG_PX = 2.0
BRIGHT_LEVEL = 200.0


def shares(preset: PresetName, code: Code, bounced: float) -> str:
    scene = Scene(camera=(600, 450), projector=(854, 570), indirect=bounced, exposure=BRIGHT_LEVEL / (1 + bounced / 2))
    sequence = replace(PRESETS[preset], code=code, cell=CELL_PX)
    try:
        decoding = scene.decode(sequence.patterns(scene.projector))
    except InputError:
        return "refused"
    matched = np.mean(decoding.reasons[scene.well_lit()] == MaskReason.KEPT)
    wrong = np.mean(np.abs(scene.errors(decoding)).max(axis=1) >= WRONG_PX)
    return f"{matched:.1%} {wrong:.3%}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bounced", type=float, nargs="+", default=[0.5, 2.5, 4, 8], help="multiples of direct light")
    options = parser.parse_args()
    table = Table(title="Well lit pixels that are matched; of the matches, how many are wrong")
    table.add_column("sequence")
    for bounced in options.bounced:
        table.add_column(f"bounced {bounced:g}", justify="right")
    for preset in ("concave", "standard"):
        for code in CODES:
            table.add_row(f"{preset}, {code}", *(shares(preset, code, bounced) for bounced in options.bounced))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
