"""Draw the diagrams of the methods into docs/images/:  python docs/make_diagrams.py"""

from pathlib import Path

from diagrams import scenes, signals, timelines

_TARGET = Path(__file__).parent / "images"
DIAGRAMS = {
    "method-corner": scenes.corner,
    "rooms": scenes.room,
    "turntable": scenes.turntable,
    "network": scenes.network,
    "decoder": signals.decoder,
    "unwrapping": signals.unwrapping,
    "acquisition": timelines.acquisition,
    "motion": timelines.motion,
    "live": timelines.live,
    "film": timelines.film,
}


def main() -> None:
    """Write every diagram."""
    for name, draw in DIAGRAMS.items():
        (_TARGET / f"{name}.svg").write_text(str(draw()), encoding="utf-8")


if __name__ == "__main__":
    main()
