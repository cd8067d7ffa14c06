"""Every command in README.md and docs/ is run in its own folder, with small images."""

import re
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from scanner.commands import main
from scanner.configuration import load_config
from scanner.io import write_png
from scanner.patterns import Black, Pattern, White, draw, gray_sequence
from tests.support.documented import PAGES, Documented, commands, commands_in, parse
from tests.support.places import ROOT

COMMANDS = commands()
OURS = [command for command in COMMANDS if not command.foreign]
RUN = [command for command in OURS if not command.why_not_run]
PARSED = [command for command in OURS if command.why_not_run]

# The documented rooms at a quarter of their size, with half the frames, and without light between their surfaces.
SHRINK = 4
SMALL = {"sequence": {"preset": "quick"}, "projector": {"width": 214, "height": 120}}
# Of the simulated camera at its full size: with so few pixels a single capture needs to know it.
PRINCIPAL_POINT_PX = (628.15, 527.15)
# What depends on the images' size.
SUBSTITUTED = {"--distance 600 500 700 600": "--distance 150 125 175 150"}
ONE_CAPTURE = "scan --config configs/room-sim.yaml"
ANOTHER_ROOM = "scan --config configs/room-sim.yaml --set rig.seed=3 --out scans/another-room"
THREE_CAPTURES = "scan --config configs/room-sim.yaml --captures 3"

Run = Callable[[str], int]


def one_after_the_other() -> pytest.MarkDecorator:
    return pytest.mark.xdist_group("documented commands")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working folder."""
    folder = tmp_path_factory.mktemp("documented")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture(scope="module")
def run(folder: Path) -> Run:
    """Run a command in a folder with the files that the documentation mentions; equal commands run once."""
    shutil.copytree(ROOT / "configs", folder / "configs")
    room = Path("configs/room-sim.yaml")
    settings = shrunk(yaml.safe_load(room.read_text(encoding="utf-8")))
    room.write_text(yaml.safe_dump(settings), encoding="utf-8")
    own = {key: settings[key] for key in ("camera", "projector")}
    Path("my-rig.yaml").write_text(yaml.safe_dump(own), encoding="utf-8")

    @cache
    def once(command: str) -> int:
        for documented, small in SUBSTITUTED.items():
            command = command.replace(documented, small)
        program, *arguments = command.split()
        if "--overwrite" not in arguments:
            for earlier in Path("scans").glob("*-measured"):  # of another page, which tells the same from the start
                shutil.rmtree(earlier)
        assert program == "scan", f"{command}: no program of ours, and not listed among those that are not run"
        return main(arguments)

    assert [once(command) for command in (ONE_CAPTURE, ANOTHER_ROOM, THREE_CAPTURES)] == [0, 0, 0]
    another, together = Path("scans/another-room"), Path("scans/room-sim-2")
    shutil.copytree(another / "capture", "my-capture")
    for name in ("calibration.yaml", "matches.npz"):
        shutil.copyfile(another / name, name)
    for name, result in (("one", together / "captures/1"), ("two", together / "captures/2"), ("three", together)):
        Path("scans", name).mkdir()
        shutil.copyfile(result / "matches.npz", Path("scans", name, "matches.npz"))
        shutil.copytree(result / "capture", Path("scans", name, "capture"))
    photograph_codes(Path("their-frames"))
    return once


def photograph_codes(folder: Path) -> None:
    """A folder as another program writes it, for a small projector that is sold, and a camera that sees exactly its
    picture.
    """
    folder.mkdir()
    width, height = 640, 480
    codes: list[Pattern] = [*gray_sequence("x", width, 1), *gray_sequence("y", height, 1), White(), Black()]
    for number, pattern in enumerate(codes):
        write_png(folder / f"im{number + 1}.png", draw(pattern, (width, height)) // 2 + 20)


def shrunk(settings: dict[str, Any]) -> dict[str, Any]:
    """The configuration with a smaller camera and projector, and fewer frames."""
    camera = settings["camera"]
    known = camera["principal_point"] = {"known": list(PRINCIPAL_POINT_PX)}
    for index, side in enumerate(("width", "height")):
        # Pixel centres are whole numbers: the image's border is half a pixel farther out.
        small = round(camera[side] / SHRINK)
        known["known"][index] = (known["known"][index] + 0.5) * small / camera[side] - 0.5
        camera[side] = small
    plain = settings["rig"] | {"interreflection": False, "ambient": 0}
    return settings | SMALL | {"rig": plain}


@one_after_the_other()
@pytest.mark.parametrize("command", RUN, ids=lambda command: f"{command.page}:{command.line} {command.text[:60]}")
def test_the_command_runs(run: Run, command: Documented, capsys: pytest.CaptureFixture[str]) -> None:
    code = run(command.text)
    assert code == 0, capsys.readouterr().err


@pytest.mark.parametrize("command", PARSED, ids=lambda command: f"{command.page}:{command.line} {command.text[:60]}")
def test_the_arguments_are_valid(command: Documented) -> None:
    parse(command)


def test_the_readme_shows_commands() -> None:
    shown = [command for command in COMMANDS if command.page == "README.md"]
    assert {ANOTHER_ROOM, THREE_CAPTURES} < {command.text for command in shown}


@one_after_the_other()
@pytest.mark.parametrize(
    "line",
    ["scan replay my-capture --scale 3", "make everything", "python benchmarks/bench_nothing.py", "scan repaly x"],
)
def test_a_wrong_command_would_be_found(line: str, run: Run) -> None:
    command = Documented("README.md", 1, line)
    if command.why_not_run:
        with pytest.raises(AssertionError):
            parse(command)
    else:
        assert run(command.text) == 2


def test_comments_variables_and_folders_are_not_part_of_a_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.support.documented.ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("```sh\nA=b .venv/bin/scan replay \\\n  x   # why\n# only words\n```\n```yaml\nscan: no\n```\n")
    assert [(command.line, command.text) for command in commands_in(page)] == [(2, "scan replay x")]


LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
INLINE = re.compile(r"`([^`\n]+)`")


def test_settings_in_the_text_exist() -> None:
    """`--set KEY=VALUE` within a sentence."""
    found = []
    for page in PAGES:
        for code in INLINE.findall(page.read_text(encoding="utf-8")):
            for override in re.findall(r"--set '?([^' ]+(?: [^' ]+)*)'?", code):
                if "KEY" not in override:
                    found.append(override)
                    load_config(ROOT / "configs" / "room-sim.yaml", [override])
    assert len(found) >= 2


def test_links_have_targets() -> None:
    links = [
        (page, target)
        for page in PAGES
        for target in LINK.findall(re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL))
    ]
    assert [
        f"{page.name}: {target}"
        for page, target in links
        if "://" not in target and not (page.parent / target).exists()
    ] == []


def test_scripts_in_the_text_exist() -> None:
    for page in PAGES:
        for code in INLINE.findall(page.read_text(encoding="utf-8")):
            for script in re.findall(r"^python ([\w/.-]+\.py)", code):
                assert (ROOT / script).is_file(), f"{page.name}: {script}"
