"""The option --set, its short names, and the list of what can be set."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from sunspin.base.errors import InputError

if TYPE_CHECKING:
    from sunspin.vehicle import Vehicle
    from sunspin.vehicle.assumptions import Assumptions
    from sunspin.vehicle.changes import Change

SHORT = {
    "friction": ("wheel.friction", "Name of another law of friction in the vehicle file: printed."),
    "wheel_speed": (
        "wheel.speed_rad_s",
        "Wheel speed (rad/s) at the first sample after touchdown.",
    ),
    "lead": ("study.lead_s", "From the first touchdown to the first sample after it, s."),
    "target_weights": (
        "study.target_weights",
        "What each measured direction counts: equal, interval.",
    ),
    "mask": ("study.mask", "Simulated directions that count: reconstructible, everywhere."),
    "factor": ("study.near_minimum_factor", "Near-minimum factor of the paper's set."),
    "confidence": ("study.confidence", "Of the calibrated set, as a share."),
    "restitution": ("collision.restitution", "Of the collision, as a share: 0 sticks."),
    "damper": ("collision.damper", "Share of the impact that the landing gear takes along z."),
}
"""Option -> key that it is a name for, its help."""

LANDING = ("body.mass_kg", "leg", "hull", "antenna")
"""What only collisions and landings use of a vehicle file."""

READING = ("telemetry", "channel", "sun_sensor", "sun_vector", "gyro", "attitude", "magnetometer")
READING += ("clock", "disturbance", "orbit")
"""What only those use who read telemetry."""

SEEING = ("panel", "panel_response", "sun_rule", *READING)
"""The same with the panels, which also say for whom the published lines were estimated."""


class Opened(NamedTuple):
    """What a command works with: the vehicle file (with changes), the vehicle, the assumptions."""

    file: Any
    craft: Vehicle
    assumptions: Assumptions

    @property
    def changes(self) -> tuple[Any, ...]:
        return (*self.craft.changes, *self.assumptions.changes)

    def mark(self, result: Any) -> Any:
        """The result, whose attributes list all changes."""
        if self.changes:
            result.attrs["changes"] = "\n".join(map(str, self.changes))
        return result


class Changeable(click.Command):
    """A command with --set; `--set list` needs no other argument."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        given = self.make_parser(ctx).parse_args(args=list(args))[0]
        if "list" in given.get("sets", ()):
            vehicle = given.get("vehicle")  # not a text where it is left out
            vehicle = vehicle if isinstance(vehicle, str) else "philae"
            print_list(vehicle, self.callback, bool(given.get("as_json")))
            ctx.exit()
        return super().parse_args(ctx, args)


def set_options(*uses: str, short: tuple[str, ...] = (), idle: tuple[str, ...] = ()) -> Callable:
    """--set and some of its short names. `uses`: keys or tables of the assumptions that the command uses; `idle`: those of the
    vehicle file that it does not use."""
    about = (
        "Change a value for this run by its key in the vehicle file: KEY=VALUE, KEY*=FACTOR or "
        "KEY+=STEP; `--set list` shows what can be set. Repeatable."
    )

    def decorate(command: Any) -> Callable:
        for name in reversed(short):
            command = click.option(f"--{name.replace('_', '-')}", help=SHORT[name][1])(command)
        vars(command).update(uses=uses, idle=idle)
        return click.option("--set", "sets", multiple=True, metavar="KEY=VALUE", help=about)(
            command
        )

    return decorate


def asked(
    sets: tuple[str, ...], short: Mapping[str, Any], own: Mapping[str, Any] | None = None
) -> tuple[Change, ...]:
    """All changes asked for; refused is one that another option says too, or of an assumption that the command does not use.

    `short`: values of short names, None where not given. `own`: those of options that the command takes for itself, which change
    no file.
    """
    from sunspin.vehicle.assumptions import TABLES, read_assumptions
    from sunspin.vehicle.changes import changes_of

    given = {name: value for name, value in {**short, **(own or {})}.items() if value is not None}
    options = {SHORT[name][0]: f"--{name.replace('_', '-')}" for name in given}
    changes = changes_of(sets)
    for change in changes:
        if option := options.get(re.sub(r"\[[^\]]*\]", "", change.key)):
            what = f"{option} and --set {change.key} say the same thing"
            raise InputError(what, do="give one of them")
        if _among(change.key, TABLES) and not _among(change.key, _of_command("uses")):
            read_assumptions([change])  # a misspelt one is refused with the nearest name
            what, do = "this command does not use that assumption", "`--set list` shows all"
            raise InputError(what, got=change.key, do=do)
    return (
        changes_of([f"{SHORT[name][0]}={given[name]}" for name in short if name in given]) + changes
    )


def opened(
    vehicle: Any,
    sets: tuple[str, ...],
    short: Mapping[str, Any],
    own: Mapping[str, Any] | None = None,
) -> Opened:
    """The vehicle and the assumptions with the changes; `short` and `own` as in `asked`."""
    from sunspin.vehicle import load_vehicle
    from sunspin.vehicle.assumptions import read_assumptions, split
    from sunspin.vehicle.file import changed_file

    changes = asked(sets, short, own)
    of_vehicle, of_study = split(changes)
    file = changed_file(vehicle, of_vehicle)
    craft, assumptions = load_vehicle(file), read_assumptions(of_study)
    say_idle(changes, _of_command("idle"))
    return Opened(file, craft, assumptions)


def say_idle(changes: Iterable[Any], idle: tuple[str, ...]) -> None:
    """Name on standard error the changes that have no effect: those of `idle` keys or tables."""
    for change in changes:
        if _among(change.key, idle):
            command = click.get_current_context().command.name
            what = f"{change.key} changes nothing here: `sunspin {command}` does not use it"
            click.echo(f"sunspin: {what}", err=True)


def _of_command(what: str) -> tuple[str, ...]:
    context = click.get_current_context(silent=True)
    return getattr(context and context.command.callback, what, ())


def _among(key: str, names: Iterable[str]) -> bool:
    """Whether a key, or the table that it is in, is one of these."""
    return key in names or re.split(r"[.\[]", key)[0] in names


def print_list(vehicle: str, command: Any, as_json: bool) -> None:
    """Key, value, unit and source of all that a command can change."""
    from sunspin.vehicle.assumptions import AssumptionsFile, assumptions_table
    from sunspin.vehicle.changes import settings, shown
    from sunspin.vehicle.file import VehicleFile, vehicle_table

    of_vehicle = settings(vehicle_table(vehicle), VehicleFile)
    of_study = settings(assumptions_table(), AssumptionsFile)
    rows = [each for each in of_vehicle if not _among(each.key, command.idle)]
    rows += [each for each in of_study if _among(each.key, command.uses)]
    if as_json:
        names = ("key", "value", "unit", "source")
        rows = [{name: getattr(each, name) for name in names} for each in rows]
        return click.echo(json.dumps(rows, indent=1))
    width = max(len(each.key) for each in rows)
    for key, value, unit, source, _ in rows:
        about = f"({source})" if source else ""
        click.echo(f"{key:{width}}  {' '.join(filter(None, (shown(value), unit, about)))}")
