"""Files beside captures and results: leftovers of earlier runs, refusals, and requests of browsers."""

import json
from dataclasses import asdict, fields
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

import numpy as np
import yaml

from tests.fuzz.guarded import Run, guarded
from tests.fuzz.mutations import Random, extreme, of_bytes, of_yaml


def refusal(folder: Path) -> Run:
    """`refused.yaml`, and its card in the history."""
    from calib.finding import Finding, FindingKind, Severity
    from scanner.results import REFUSAL_FILE, Verdict, verdict_entries, verdict_of, write_refusal
    from scanner.viewing import notes_text, verdict_text

    path = folder / REFUSAL_FILE
    kind = FindingKind("too-warm", "It is too warm.", data=("rooms", "temperature_c"))
    finding = Finding(kind, Severity.NOTE, "It is warm.", data={"rooms": (1, 2), "temperature_c": 31.5})
    write_refusal(path, verdict_entries(Verdict("refused", "No", ("because", "of this"), "Again", (finding,), (kind,))))
    seed = yaml.safe_load(path.read_text())

    def read(rng: Random) -> None:
        path.write_bytes(of_yaml(seed, rng))
        found = verdict_of(folder)
        assert "<" not in (verdict_text(found) + notes_text(found)).replace("\\<", "")

    return guarded(read)


def log(folder: Path) -> Run:
    """`scan.log`, from which the durations of the steps are read."""
    from scanner.console import durations_in

    path = folder / "scan.log"
    lines = [f"2024-01-01 00:00:0{n},123 INFO scanner.ui.terminal: Step {n}: {n}" for n in range(6)]
    seed = "\n".join(lines).encode()

    def read(rng: Random) -> None:
        path.write_bytes(of_bytes(seed, rng))
        assert all(np.isfinite(seconds) for seconds in durations_in(path).values())

    return guarded(read)


def row(folder: Path) -> Run:
    """A row of an earlier run of a batch, and its table."""
    from scanner.batch import BatchJob, BatchRow, run_batch
    from scanner.configuration import Config
    from scanner.ui import Terminal

    path, terminal = folder / "rows" / "a.json", Terminal(quiet=True)
    path.parent.mkdir()
    job = BatchJob("a", "somewhere", Config(), None)
    whole = asdict(BatchRow("a", "somewhere", "there", 0, "good", "Well", None, 9, 8, 0.1, 300.0, 1.0, asked=job.asked))
    names = [field.name for field in fields(BatchRow)]
    odd: tuple[Any, ...] = (
        None,
        "x",
        "\x1b[31m",
        -1,
        10**30,
        1e308,
        float("nan"),
        float("inf"),
        [],
        {},
        True,
        "é" * 400,
        "<script>",
    )

    def read(rng: Random) -> None:
        changed: dict[str, Any] = dict(whole)
        for _ in range(int(rng.integers(3))):
            changed[names[int(rng.integers(len(names)))]] = odd[int(rng.integers(len(odd)))]
        data = json.dumps(changed).encode()
        path.write_bytes(of_bytes(data, rng) if rng.random() < 0.3 else b"[" * 100_000 if rng.random() < 0.01 else data)
        run_batch([job], str(folder), None, terminal)

    return guarded(read)


def left_behind(folder: Path) -> Run:
    """A killed scan with a damaged state and listing: it is settled, and no live frame is lost."""
    from scanner.results import frames_in, settle
    from tests.support.small_capture import read_listing, write_capture

    write_capture(folder / "seed")
    listing = read_listing(folder / "seed")
    states = (
        b"live      1         \n",
        b"made      1         \n",
        b"whole     1         \n",
        b"replacing 1         \n",
    )

    def read(rng: Random) -> None:
        place = folder / "place"
        place.mkdir()
        try:
            partial = place / ".room.partial"
            copytree(folder / "seed", partial / "capture")
            (partial / "capture" / "capture.yaml").write_bytes(of_yaml(listing, rng))
            state = states[int(rng.integers(len(states)))]
            is_live = state.startswith(b"live")
            (partial / ".scan-unfinished").write_bytes(state if rng.random() < 0.5 else of_bytes(state, rng))
            if rng.random() < 0.3:
                (place / "room").mkdir()
            frames = frames_in(partial)
            told = settle(place / "room")
            assert told
            assert frames_in(place) in ((frames,) if is_live and "held no frames" not in told[0] else (0, frames))
        finally:
            rmtree(place)

    return guarded(read)


def compared(folder: Path) -> Run:
    """Two calibrations, one of them with extreme values: compared, summarised and drawn."""
    from scanner.comparing import compare_files, rows, write_compare, write_compare_page
    from tests.support.result_folder import write_result

    written = write_result(folder / "room", keep=lambda px: np.all(px % 16 < 1, axis=1))
    seed = yaml.safe_load((written.folder / "calibration.yaml").read_text())
    other = folder / "other.yaml"

    def read(rng: Random) -> None:
        changed = yaml.safe_load(yaml.safe_dump(seed))
        for _ in range(int(rng.integers(1, 3))):
            device = changed["camera" if rng.random() < 0.5 else "projector"]
            key = ("focal_px", "principal_point_px", "distortion")[int(rng.integers(3))]
            at = int(rng.integers(len(device[key])))
            device[key][at] = abs(extreme(300.0, rng)) if key == "focal_px" else extreme(device[key][at] or 0.05, rng)
        if rng.random() < 0.3:
            changed["translation"] = [extreme(number, rng) for number in changed["translation"]]
        other.write_text(yaml.safe_dump(changed))
        first, second = (written.folder, other) if rng.random() < 0.5 else (other, written.folder)
        found = compare_files(first, second)
        list(rows(found))
        write_compare(folder / "compare.json", found)
        write_compare_page(folder / "compare.html", found)

    return guarded(read)


def asked(folder: Path) -> Run:
    """Requests of a browser, by path and headers: only offered files are served."""
    from scanner.viewing import OriginCheck, ServedFiles

    result = folder / "results" / "a room"
    result.mkdir(parents=True)
    (result / "report.html").write_text("offered")
    (folder / "secret.html").write_text("secret")
    served_files = ServedFiles()
    link = served_files.link(result / "report.html")
    keeper = OriginCheck("127.0.0.1", served_files.answer)
    told = keeper.answer(f"/?token={keeper.token}", {"Host": "127.0.0.1:8080"})
    assert told is not None
    cookie = told.headers["Set-Cookie"].split(";")[0]
    paths = (link, "/", f"{link}/../../../secret.html", link.replace("report", "..%2f..%2f..%2fsecret"), "/results/")

    def changed(text: str, rng: Random, share: float) -> str:
        return of_bytes(text.encode(), rng).decode("latin-1") if rng.random() < share else text

    def read(rng: Random) -> None:
        headers = {
            "Host": changed("127.0.0.1:8080", rng, 0.3),
            "Origin": changed("http://127.0.0.1:8080", rng, 0.3),
            "Cookie": changed(cookie, rng, 0.3),
        }
        path = changed(paths[int(rng.integers(len(paths)))], rng, 0.7)
        answer = keeper.answer(path, headers)
        let_in = answer is None or answer.status_code != 403
        assert not let_in or keeper.token in headers["Cookie"]
        assert not let_in or headers["Origin"].partition("//")[2] == headers["Host"]
        assert answer is None or b"secret" not in (answer.body or b"")

    return guarded(read)
