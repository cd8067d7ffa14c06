"""Measurements as tables on the terminal."""

from collections.abc import Iterator

from rich import box
from rich.table import Table

from scanner.measuring.measurements import FitErrors, Measurements, SphereMeasurement
from scanner.quantities import ShownUnit, plain, shown_unit


def tables(measured: Measurements) -> Iterator[Table]:
    """A table for each kind of thing that was measured."""
    unit = shown_unit(measured.unit)
    for number, sphere in enumerate(measured.spheres, start=1):
        yield _sphere_table(sphere, number, unit)
    if measured.faces:
        table = _table("Faces", "points", "mean abs. error", "rms", "99.7 % within")
        for face in measured.faces:
            table.add_row(f"  {face.name}", *_error_cells(face.errors, unit))
        yield table
    if measured.angles:
        table = _table("Angles between the faces", "angle", "sigma")
        for angle in measured.angles:
            names = f"  {angle.faces[0]} and {angle.faces[1]}"
            table.add_row(names, f"{plain(angle.angle_deg, 4)}°", f"± {plain(angle.sigma_deg, 4)}°")
        yield table
    if measured.distances:
        table = _table("Distances", "distance")
        for distance in measured.distances:
            names = f"  {distance.names[0]} to {distance.names[1]}"
            table.add_row(names, unit.length(distance.distance, distance.sigma))
        yield table


def _sphere_table(sphere: SphereMeasurement, number: int, unit: ShownUnit) -> Table:
    x, y, radius = sphere.image_px
    table = _table(f"Sphere {number}, at camera pixel ({x:.0f}, {y:.0f}), {2 * radius:.0f} pixels across", "")
    for name, value in (
        ("diameter", unit.length(sphere.diameter, sphere.diameter_sigma)),
        ("nominal diameter", unit.length(sphere.nominal_diameter)),
        ("size error", unit.error(sphere.diameter - sphere.nominal_diameter, signed=True)),
        ("points", f"{len(sphere.errors.residual):,}"),
        ("strays, left out", f"{sphere.strays:,}"),
        ("mean absolute error", unit.error(sphere.errors.mean_absolute)),
        ("rms", unit.error(sphere.errors.rms)),
        ("99.7 % of the points within", unit.error(sphere.errors.form)),
        ("mean absolute error, nominal size", unit.error(sphere.nominal_errors.mean_absolute)),
    ):
        table.add_row(f"  {name}", value)
    return table


def _error_cells(errors: FitErrors, unit: ShownUnit) -> tuple[str, ...]:
    lengths = (errors.mean_absolute, errors.rms, errors.form)
    return (f"{len(errors.residual):,}", *(unit.error(length) for length in lengths))


def _table(title: str, *headings: str) -> Table:
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE,
        pad_edge=False,
        collapse_padding=True,
        show_header=any(headings),
    )
    table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
