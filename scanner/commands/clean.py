"""Do named steps to a result's cloud: a box, cleaning, fewer triangles, other axes. They can be undone."""

from scanner.cleaning import OF_MESH, CleanedResult, read_cleaned
from scanner.commands.options_of_results import CleanCommand
from scanner.configuration import MOST_STEPS, CloudStep
from scanner.errors import InputError
from scanner.exporting import mesh_of_result
from scanner.io import validate
from scanner.quantities import UNKNOWN_UNIT, empty_table, unit_name
from scanner.results import STEPS_FILE, read_steps, write_steps
from scanner.ui import Terminal


def run(args: CleanCommand) -> None:
    """Do the work. Raises InputError, StorageError."""
    terminal = Terminal(quiet=args.quiet)
    earlier = read_steps(args.result)
    wanted = [*earlier]
    if args.undo:
        if args.steps:
            raise InputError("--undo takes the last step back: give no other step with it")
        if not wanted:
            raise InputError(f"{args.result}: has no step to undo")
        wanted.pop()
    wanted += [validate(CloudStep, {name: parameter}, f"--{name}") for name, parameter in args.steps or ()]
    if len(wanted) > MOST_STEPS:
        raise InputError(
            f"{args.result}: expected {MOST_STEPS} steps or fewer, found {len(wanted)}; --undo takes one back"
        )
    with terminal.step("Cleaning"):
        cleaned = read_cleaned(args.result, steps=wanted)
        counts = [len(cloud) for cloud in cleaned.clouds()]
        triangles = _triangles(cleaned)
    if wanted != [*earlier]:
        write_steps(args.result, wanted)
    table = empty_table("Steps", "points left")
    table.add_row("as measured", f"{counts[0]:,}")
    for number, (step, count) in enumerate(zip(wanted, counts[1:], strict=True), start=1):
        table.add_row(f"{number}: {step}", f"{count:,}")
    terminal.show(table)
    if triangles:
        terminal.show(f"The mesh has {triangles:,} triangles then.")
    if wanted and cleaned.unit == UNKNOWN_UNIT:
        terminal.show(f"Note: no length is known, so lengths are in {unit_name(cleaned.unit)}.")
    if wanted != [*earlier]:
        name = args.result / STEPS_FILE
        terminal.show(f"Written: {name}" if wanted else f"Removed: {name}")
    terminal.show(f"→ scan export {args.result} --to ply writes what is left; the cloud in the result is as measured.")


def _triangles(cleaned: CleanedResult) -> int:
    """Of the mesh, which is made if a step changes it: whether it can be done is known now."""
    return len(mesh_of_result(cleaned).triangles) if any(step.name in OF_MESH for step in cleaned.steps) else 0
