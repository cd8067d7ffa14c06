"""Compare two calibrations of one rig, or a surface with its reference: where they differ, and by how many sigmas."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from scanner.commands.options_of_results import CompareCommand
from scanner.comparing import (
    CLOUD_FILE,
    COMPARE_FILE,
    COMPARE_PAGE,
    MESH_FILE,
    REFERENCE_CLOUD_FILE,
    REFERENCE_MESH_FILE,
    Conformity,
    SurfaceComparison,
    compare_files,
    compare_surfaces,
    comparison_verdict,
    deviation_mesh,
    reference_mesh,
    region_table,
    surface_verdict,
    table,
    write_compare,
    write_compare_page,
    write_deviation_cloud,
    write_deviation_mesh,
    write_reference_cloud,
    write_surface_document,
    write_surface_page,
)
from scanner.errors import InputError
from scanner.io import is_surface_file, new_files, refuse_existing
from scanner.results import NETWORK, kind_of
from scanner.shown_text import shown
from scanner.ui import EXIT_DIFFERENT, EXIT_REFUSED, Terminal


def run(args: CompareCommand) -> int:
    """Do the work; returns the exit code. Raises InputError."""
    terminal = Terminal(quiet=args.quiet)
    if args.surfaces or any(_has_only_a_surface(path) for path in (args.first, args.second)):
        return _compare_surfaces(args, terminal)
    for name, given in (("--tolerance", args.tolerance), ("--unit", args.unit), ("--scale-free", args.scale_free)):
        if given:
            raise InputError(
                f"{name} is for surfaces, and these are two calibrations: add --surfaces to compare surfaces"
            )
    return _compare_calibrations(args, terminal)


def _has_only_a_surface(path: Path) -> bool:
    """Whether there is nothing else to compare: a cloud, a mesh, or a network."""
    return kind_of(path) is NETWORK if path.is_dir() else is_surface_file(path)


def _compare_calibrations(args: CompareCommand, terminal: Terminal) -> int:
    if args.out:
        for name in (COMPARE_FILE, COMPARE_PAGE):
            refuse_existing(args.out / name, overwrite=args.overwrite)
    depths = [depth for depth in (args.depths or "").split(",") if depth.strip()]
    if args.depths is not None and not depths:
        raise InputError(f"--depths: expected lengths, as in 1m,2m,3m, found {shown(args.depths)}")
    comparison = compare_files(args.first, args.second, depths)
    verdict = comparison_verdict(comparison)
    terminal.show(
        table(comparison), f"{verdict.sign} {verdict.headline}", *(f"  {reason}" for reason in verdict.reasons)
    )
    if args.out:
        with new_files(args.out, (COMPARE_FILE, COMPARE_PAGE), overwrite=args.overwrite) as (document, page):
            write_compare(document, comparison)
            write_compare_page(page, comparison)
        terminal.show(
            f"Written: {args.out} ({COMPARE_PAGE}, {COMPARE_FILE})",
            f"→ Open {args.out / COMPARE_PAGE} in a browser: where in the picture they differ.",
        )
    else:
        terminal.show("→ The same command with --out DIR draws where in the picture they differ.")
    return EXIT_DIFFERENT if verdict.grade == "refused" and not args.allow else 0


def _compare_surfaces(args: CompareCommand, terminal: Terminal) -> int:
    if args.depths is not None:
        raise InputError("--depths is for calibrations, and these are surfaces")
    if args.out:
        for name in (COMPARE_FILE, COMPARE_PAGE, CLOUD_FILE, MESH_FILE, REFERENCE_CLOUD_FILE, REFERENCE_MESH_FILE):
            refuse_existing(args.out / name, overwrite=args.overwrite)
    with terminal.step("Comparing"):
        comparison = compare_surfaces(
            args.first, args.second, unit=args.unit, scale_free=args.scale_free, tolerance=args.tolerance
        )
    verdict = surface_verdict(comparison)
    if comparison.regions:
        terminal.show(region_table(comparison))
    terminal.show(
        f"{verdict.sign} {verdict.headline}", *(f"  {reason}" for reason in verdict.reasons), *comparison.notes
    )
    if verdict.advice:
        terminal.show(f"→ {verdict.advice}")
    if args.out:
        _write(args, comparison, terminal)
    else:
        terminal.show("→ The same command with --out DIR draws where they differ.")
    return _exit_code(comparison, allow=args.allow)


def _write(args: CompareCommand, comparison: SurfaceComparison, terminal: Terminal) -> None:
    assert args.out is not None
    writers: dict[str, Callable[[Path], None]] = {
        COMPARE_FILE: partial(write_surface_document, comparison=comparison),
        COMPARE_PAGE: partial(write_surface_page, comparison=comparison),
    }
    if comparison.is_aligned:
        writers[CLOUD_FILE] = partial(write_deviation_cloud, comparison=comparison)
        writers[REFERENCE_CLOUD_FILE] = partial(write_reference_cloud, comparison=comparison)
        meshes = {MESH_FILE: deviation_mesh(comparison, args.first), REFERENCE_MESH_FILE: reference_mesh(comparison)}
        writers |= {name: partial(write_deviation_mesh, mesh=mesh) for name, mesh in meshes.items() if mesh is not None}
    with new_files(args.out, list(writers), overwrite=args.overwrite) as paths:
        for write, path in zip(writers.values(), paths, strict=True):
            write(path)
    terminal.show(
        f"Written: {args.out} ({', '.join(writers)})",
        f"→ Open {args.out / COMPARE_PAGE} in a browser: "
        + ("where the surface deviates." if comparison.is_aligned else "what is known of the alignment."),
    )


def _exit_code(comparison: SurfaceComparison, *, allow: bool) -> int:
    if not comparison.is_aligned or not len(comparison.compared):
        return EXIT_REFUSED
    if comparison.test is None or comparison.test.conformity is Conformity.PASS:
        return 0
    if comparison.test.conformity is Conformity.UNDECIDED:
        return EXIT_REFUSED
    return 0 if allow else EXIT_DIFFERENT
