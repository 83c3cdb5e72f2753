"""`sunspin init` and `sunspin check`."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import click

from sunspin.cli.common import data_option, find_telemetry
from sunspin.errors import OutputError, sentence

TEMPLATES = ("vehicle.toml", "telemetry.csv")


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
def init(folder: Path) -> None:
    """Write a commented vehicle.toml and a telemetry.csv to start from. Existing files are never overwritten.

    \b
    Example:
      sunspin init my-satellite
      sunspin check my-satellite/vehicle.toml my-satellite/telemetry.csv
    """
    source = resources.files("sunspin").joinpath("template")
    try:
        for name in TEMPLATES:
            if (folder / name).exists():
                raise OutputError(sentence("this file is there already", do="choose another folder", where=str(folder / name)))
        folder.mkdir(parents=True, exist_ok=True)
        for name in TEMPLATES:
            with open(folder / name, "x", encoding="utf-8") as target:
                target.write(source.joinpath(name).read_text(encoding="utf-8"))
    except OSError as error:
        raise OutputError(
            sentence(f"files cannot be written here ({error.strerror or error})", do="choose another folder", where=str(folder))
        ) from None
    click.echo(f"Wrote {folder / 'vehicle.toml'} and {folder / 'telemetry.csv'} (synthetic samples).")
    click.echo(f"Next: sunspin check {folder / 'vehicle.toml'} {folder / 'telemetry.csv'}")


@click.command()
@click.argument("vehicle")
@click.argument("telemetry", required=False)
@data_option
def check(vehicle: str, telemetry: str | None, data: Path | None) -> None:
    """Say what is wrong with a vehicle file and telemetry, or what they hold.

    \b
    Example:
      sunspin check philae
      sunspin check vehicle.toml telemetry.csv
    """
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    known = "known" if craft.inertia_kg_m2 is not None else "not given (the motion cannot be computed)"
    click.echo(f"Vehicle {craft.name}: {len(craft.panels)} panels, {len(craft.wheels)} wheels, {len(craft.legs)} legs")
    click.echo(f"  inertia {known}")
    if craft.panels:
        from sunspin.measure.panels import lit_patterns
        from sunspin.measure.sun import reconstructible_patterns

        patterns, good = lit_patterns(craft), reconstructible_patterns(craft)
        click.echo(f"  the Sun can light {len(patterns)} sets of panels; {len(good)} of them give a direction")
    if telemetry is not None:
        _check_telemetry(craft, find_telemetry(telemetry, data))


def _check_telemetry(craft, path: Path) -> None:
    from sunspin.cli.measured import status_lines
    from sunspin.measure.sun import sun_directions
    from sunspin.measure.telemetry import read_telemetry

    samples = read_telemetry(path, craft)
    sun = sun_directions(craft, samples)
    time = samples["time"].values
    kind = "synthetic " if samples.attrs["synthetic"] else ""
    click.echo(f"Telemetry {samples.attrs['file']}: {time.size} {kind}samples over {time[-1] - time[0]:.0f} s")
    for line in status_lines(sun):
        click.echo(line)
