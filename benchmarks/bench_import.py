"""Import frames of every known order, and of cameras and projectors that do not do as they should.

    python benchmarks/bench_import.py [--seeds 0 1 2]

Rooms are simulated, and drawn anew for each seed. A capture is *right* if it has the projector's size and the patterns
that were shown, but for bits that the camera does not resolve and frames without stripes; *asked* if the right answer
is among those that are numbered; *refused* if there is no answer, else *wrong*. Exit code 1 if one is wrong.
"""

import argparse
import io
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calib.numerics import Image
from scanner.capture import open_capture
from scanner.patterns import Black, Gray, Pattern, White
from tests.support.foreign_captures import (
    CAMERA,
    ENDS,
    FOREIGN,
    PAIRS,
    PROJECTOR,
    TURNS,
    Photographer,
    bits,
    imported,
    named,
    photographer,
    same,
)

_DARKER, _BRIGHTER = 0.7, 1.4  # gains of automatic exposure


@dataclass(frozen=True)
class Trouble:
    """Frames of `shown`, of which `true` are the sequence."""

    shown: list[Pattern]
    """In the order of the files."""
    true: list[Pattern]
    """What an import should find, or a coarser part of it."""
    arguments: tuple[str, ...] = ()
    """Of the command."""
    change: Callable[[Image], Image] = np.asarray
    """What the camera, or the way to the file, does to each frame."""
    spoil: Callable[[Path], None] = lambda _: None
    """What happens to the folder."""


def main() -> int:
    """Print a row for each kind, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    seeds = parser.parse_args().seeds
    rows: dict[str, Counter[str]] = {}
    for seed in seeds:
        camera = photographer(CAMERA, PROJECTOR, seed)
        for name, trouble in _kinds(seed):
            rows.setdefault(name, Counter())[_outcome(camera, trouble)] += 1
    print(f"{'frames':<36} right asked refused wrong")
    for name, counts in rows.items():
        print(f"{name:<36} {counts['right']:5d} {counts['asked']:5d} {counts['refused']:7d} {counts['wrong']:5d}")
    total = sum(rows.values(), Counter())
    print(f"{sum(total.values())} imports: {', '.join(f'{count} {outcome}' for outcome, count in total.most_common())}")
    return 1 if total["wrong"] else 0


def _kinds(seed: int) -> Iterator[tuple[str, Trouble]]:
    rng = np.random.default_rng([seed, 7])
    for name, known in FOREIGN.items():
        yield name, Trouble(known.patterns, known.patterns, known.arguments, known.change)
    pairs = [*PAIRS, *ENDS]
    plain = [*ENDS, *bits("x", 10, inverses=False), *bits("y", 9, inverses=False)]
    late = int(rng.integers(1, len(PAIRS) - 8))

    def gained(image: Image) -> Image:
        levels: Image = np.clip(np.rint(image * rng.uniform(_DARKER, _BRIGHTER)), 0, 255).astype(np.uint8)
        return levels

    def noisy(image: Image) -> Image:
        return np.clip(image + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8)

    def blurred(image: Image) -> Image:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.2), np.uint8)

    yield "gains of 0.7 to 1.4", Trouble(pairs, pairs, change=gained)
    yield "ambient light first", Trouble([Black(), *ENDS, *PAIRS], [*ENDS, *PAIRS], change=noisy)
    yield "a texture last", Trouble([*pairs, White()], pairs, change=noisy)
    yield (
        "two frames first, by turns",
        Trouble([Black(), White(), *TURNS, Gray("x", 9, 10)], [*TURNS, Gray("x", 9, 10)], change=noisy),
    )
    yield "a late frame", Trouble(pairs, pairs, change=noisy, spoil=lambda folder: _repeat(folder, late))
    yield "mirrored, with --flip x", Trouble(pairs, pairs, ("--flip", "x"), lambda image: image[:, ::-1].copy())
    yield "upside down, with --flip y", Trouble(pairs, pairs, ("--flip", "y"), lambda image: image[::-1].copy())
    yield "without inverses", Trouble(plain, plain, change=noisy)
    yield "blurred, with inverses", Trouble(pairs, pairs, change=blurred)
    yield "blurred, without inverses", Trouble(plain, plain, change=blurred)


def _repeat(folder: Path, number: int) -> None:
    """The projector is late: a frame shows the picture before."""
    shutil.copyfile(folder / f"{number - 1:03d}.png", folder / f"{number:03d}.png")


def _outcome(camera: Photographer, trouble: Trouble) -> str:
    with tempfile.TemporaryDirectory() as temporary:
        source, out = Path(temporary) / "frames", Path(temporary) / "out"
        camera.write(source, trouble.shown, named("{:03d}.png"), trouble.change)
        trouble.spoil(source)
        printed = io.StringIO()
        with redirect_stdout(printed), redirect_stderr(printed):
            code = imported(source, "--out", out, *trouble.arguments)
        size = f"projector {PROJECTOR[0]} × {PROJECTOR[1]};"
        if code:
            return "asked" if "--order" in printed.getvalue() and size in printed.getvalue() else "refused"
        recording = open_capture(out)
        return (
            "right" if recording.projector_size == PROJECTOR and _agree(recording.patterns, trouble.true) else "wrong"
        )


def _agree(patterns: tuple[Pattern, ...], true: list[Pattern]) -> bool:
    """Whether the sequence is the true one; frames of nothing do not count, and bits may be missing at the fine end."""
    extremes = (White, Black)
    stripes = [pattern for pattern in patterns if not isinstance(pattern, extremes)]
    wanted = [pattern for pattern in true if not isinstance(pattern, extremes)]
    if len(stripes) == len(wanted):
        return all(map(same, stripes, wanted))
    x, y = np.meshgrid(np.arange(PROJECTOR[0], dtype=float), np.arange(PROJECTOR[1], dtype=float))
    lights = {pattern.brightness(x, y).tobytes() for pattern in wanted}
    return 0.6 * len(wanted) < len(stripes) and all(pattern.brightness(x, y).tobytes() in lights for pattern in stripes)


if __name__ == "__main__":
    sys.exit(main())
