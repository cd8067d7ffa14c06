"""Clean up after scans that were killed: keep their frames, move complete results into place, remove the rest."""

import shutil
from pathlib import Path

from scanner.capture import open_capture
from scanner.errors import InputError, cannot_write
from scanner.io import MATCHES_FILE
from scanner.results.names import (
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    LOG_FILE,
    TRUTH_FILE,
    is_occupied,
    refuse_to_lose,
    unused,
)
from scanner.results.unfinished import (
    STATE,
    Claim,
    FolderState,
    LockedError,
    finish_publishing,
    partial_of,
    publish,
    target_of,
)

_RECORDED = {CAPTURE_FOLDER, CAPTURES_FOLDER, LOG_FILE, TRUTH_FILE}
_RECORDED_OF_SEVERAL = {CAPTURE_FOLDER, MATCHES_FILE}


def settle(out: Path) -> list[str]:
    """Settle leftovers of `out`, and of others in its folder; returns sentences about them.

    Raises InputError if `out` has no name, a process is making it now, or something else blocks it; StorageError.
    """
    if out.name in ("", ".."):
        raise InputError(f"{out}: expected the name of a folder to make, as in --out scans/room")
    messages = []
    for partial in sorted({partial_of(out), *out.parent.glob(".*.partial")}):
        target = target_of(partial)
        try:
            messages += _settle(partial, target, in_the_way=target == out)
        except LockedError as error:
            if target == out:
                raise InputError(f"{out}: {error}") from error
        except OSError as error:
            if target == out:
                raise cannot_write(partial, error, "tidied up") from error
    return messages


def _settle(partial: Path, out: Path, *, in_the_way: bool) -> list[str]:
    finish_publishing(out)
    if not partial.is_dir() or partial.is_symlink():
        return []
    if not any(partial.iterdir()):
        partial.rmdir()
        return []
    if not (partial / STATE).is_file():
        if in_the_way:
            raise InputError(f"{partial}: exists but was not left by a scan: check its content, and remove it")
        return []
    claim = Claim(partial / STATE)
    try:
        if not claim.is_current:
            return []  # another program has just settled it
        if claim.state is None and not in_the_way:
            return []  # another scan is just beginning there
        return _judged(claim.state, partial, out)
    finally:
        claim.release()


def _judged(state: FolderState | None, partial: Path, out: Path) -> list[str]:
    if state in (FolderState.WHOLE, FolderState.REPLACING):
        place = out if _may_take(out, replacing=state is FolderState.REPLACING) else unused(out)
        publish(partial, place)
        return [f"A scan was killed after its result was complete: it is in {place} now."]
    if state is FolderState.LIVE and frames_in(partial):
        return [f"A scan was killed. {kept_text(keep_recording(partial, out))}"]
    shutil.rmtree(partial)
    return [f"The remains of {out}, left by a killed program, held no frames and were removed."]


def _may_take(out: Path, *, replacing: bool) -> bool:
    if not is_occupied(out):
        return True
    try:
        refuse_to_lose(out, overwrite=replacing)
    except InputError:
        return False
    return True


def keep_recording(partial: Path, out: Path) -> Path:
    """Move the frames of an unfinished scan to a visible name, which is returned, and remove the rest.

    Nothing can then be mistaken for a result. Raises OSError.
    """
    for folder, recorded in [(partial, _RECORDED), *((capture, _RECORDED_OF_SEVERAL) for capture in _whole(partial))]:
        for path in folder.iterdir():
            if path.name in recorded or path.name == STATE:
                continue
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    kept = unused(out.with_name(f"{out.name}-incomplete"))
    partial.rename(kept)
    (kept / STATE).unlink()
    return kept


def kept_text(kept: Path, *, refuted: bool = False) -> str:
    """State where the frames are, and what can be done with them; `refuted`: they cannot be reconstructed as they
    are.
    """
    captures = _whole(kept)
    if captures and not (kept / CAPTURE_FOLDER).is_dir():  # of a network or of stations
        whole = sum(_is_complete(capture / CAPTURE_FOLDER) for capture in captures)
        taken_by = "scan network" if "-" in captures[0].name else "scan room, object or board"
        return (
            f"What was captured so far is kept in {kept / CAPTURES_FOLDER}: {whole} of {len(captures)} captures are "
            f"whole, and {taken_by} takes those."
        )
    recording, frames = kept / CAPTURE_FOLDER, frames_in(kept / CAPTURE_FOLDER)
    if _is_complete(recording):
        makes = "gives the same refusal" if refuted else "makes a result of them"
        to_do = f"none is missing, and scan replay {recording} {makes}"
    else:
        to_do = f"scan --resume {kept} takes the missing ones, and scan replay {recording} reconstructs what there is"
    if not captures:
        return f"The {frames} frames captured so far are in {recording}: {to_do}."
    finished = len(captures)
    return (
        f"What was captured so far is kept: {finished} complete capture{'s' if finished > 1 else ''} in "
        f"{kept / CAPTURES_FOLDER}, which scan calibrate takes, and {frames} frames in {recording}: {to_do}."
    )


def _is_complete(folder: Path) -> bool:
    try:
        recording = open_capture(folder)
    except InputError:
        return False
    return len(recording.planned) == len(recording.patterns)


def _whole(folder: Path) -> list[Path]:
    """The captures of several that were over; of a network's further stations those in their folders."""
    captures = (folder / CAPTURES_FOLDER).glob("*/")
    return sorted(path for capture in captures for path in [*capture.glob("*-*/")] or [capture])


def frames_in(folder: Path) -> int:
    """Count the frames recorded anywhere in a folder."""
    return len(list(folder.glob("**/frames/*.png")))
