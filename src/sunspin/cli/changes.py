"""The option --set, its short names, and the list of what can be set."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable
from functools import wraps
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from click.core import ParameterSource

from sunspin.base.errors import InputError
from sunspin.cli.values import check_text

if TYPE_CHECKING:
    from sunspin.vehicle import Vehicle
    from sunspin.vehicle.assumptions import Assumptions
    from sunspin.vehicle.changes import Change

SHORT = {
    "friction": (
        "wheel.friction",
        "Wheel-friction law, by name in the vehicle file, e.g. `printed`.",
    ),
    "wheel_speed": ("wheel.speed_rad_s", "Wheel speed at the first sample after touchdown, rad/s."),
    "lead": ("study.lead_s", "Time from the first touchdown to the next sample, s."),
    "target_weights": (
        "study.target_weights",
        "Weights of the measured Sun directions: equal, or interval (by the time between samples).",
    ),
    "mask": (
        "study.mask",
        "Simulated Sun directions that count: reconstructible (from the panels) or everywhere (all).",
    ),
    "factor": ("study.near_minimum_factor", "The paper's set: EMD below this times the smallest."),
    "confidence": ("study.confidence", "Confidence level of --candidates scan, e.g. 0.9."),
    "restitution": ("collision.restitution", "Coefficient of restitution (0 = sticking)."),
    "damper": ("collision.damper", "Fraction of the body-z impulse that the landing gear absorbs."),
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


class Command(click.Command):
    """A command whose texts are checked before they are converted, and of which `--set list` needs no other argument. If it is
    refused, it leaves no empty results folder."""

    def invoke(self, ctx: click.Context) -> Any:
        folder = "sunspin.output.folder"  # not imported: without it no folder was claimed
        try:
            done = super().invoke(ctx)
        except BaseException:  # an interruption too
            if folder in sys.modules:
                sys.modules[folder].leave_no_empty_folder()
            raise
        if folder in sys.modules:
            sys.modules[folder].keep_folders()
        return done

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if ctx.resilient_parsing:  # what a shell completes is not whole yet
            return super().parse_args(ctx, args)
        given = self.make_parser(ctx).parse_args(args=list(args))[0]
        for parameter in self.params:
            values = given.get(parameter.name)
            for text in values if isinstance(values, list | tuple) else (values,):
                check_text(text, parameter, ctx)
        if "list" in given.get("sets", ()):
            vehicle = given.get("vehicle")  # not a text where it is left out
            vehicle = vehicle if isinstance(vehicle, str) else "philae"
            print_list(vehicle, self.callback, bool(given.get("as_json")))
            ctx.exit()
        return super().parse_args(ctx, args)


def set_options(*uses: str, short: tuple[str, ...] = (), idle: tuple[str, ...] = ()) -> Callable:
    """--set and some of its short names, which the command receives as one `changes`; refused is a change that another option says
    too, or of an assumption that the command does not use.

    `uses`: keys or tables of the assumptions that the command uses; `idle`: those of the vehicle file that it does not use.
    """
    about = (
        "Override a value of the vehicle file or the study for this run: KEY=VALUE, KEY*=FACTOR or "
        "KEY+=STEP. `--set list` prints all keys. Repeatable."
    )

    def decorate(function: Any) -> Callable:
        @wraps(function)
        def command(sets: tuple[str, ...], **given: Any) -> None:
            from sunspin.vehicle.assumptions import TABLES, read_assumptions
            from sunspin.vehicle.changes import parse_changes

            source = click.get_current_context().get_parameter_source
            typed = [name for name in given if source(name) is ParameterSource.COMMANDLINE]
            said = {SHORT[name][0]: name for name in typed if name in SHORT}
            changes = parse_changes(sets)
            for change in changes:
                if name := said.get(re.sub(r"\[[^\]]*\]", "", change.key)):
                    what = f"--{name.replace('_', '-')} and --set {change.key} say the same thing"
                    raise InputError(what, do="give one of them")
                if _among(change.key, TABLES) and not _among(change.key, uses):
                    read_assumptions([change])  # a misspelt one is refused with the nearest name
                    what, do = "this command does not use that assumption", "`--set list` shows all"
                    raise InputError(what, got=change.key, do=do)
            values = [(SHORT[name][0], given.pop(name)) for name in short]
            own = parse_changes([f"{key}={value}" for key, value in values if value is not None])
            function(changes=own + changes, **given)

        decorated: Any = command
        for name in reversed(short):
            decorated = click.option(f"--{name.replace('_', '-')}", help=SHORT[name][1])(decorated)
        vars(decorated).update(uses=uses, idle=idle)
        option = click.option("--set", "sets", multiple=True, metavar="KEY=VALUE", help=about)
        return option(decorated)

    return decorate


def opened(vehicle: Any, changes: Iterable[Change]) -> Opened:
    """The vehicle and the assumptions with the changes."""
    from sunspin.vehicle import load_vehicle
    from sunspin.vehicle.assumptions import read_assumptions, split_changes
    from sunspin.vehicle.file import attach_changes

    of_vehicle, of_study = split_changes(changes)
    file = attach_changes(vehicle, of_vehicle)
    craft, assumptions = load_vehicle(file), read_assumptions(of_study)
    context = click.get_current_context(silent=True)
    say_idle(changes, getattr(context and context.command.callback, "idle", ()))
    return Opened(file, craft, assumptions)


def say_idle(changes: Iterable[Any], idle: tuple[str, ...]) -> None:
    """Name on standard error the changes that have no effect: those of `idle` keys or tables."""
    for change in changes:
        if _among(change.key, idle):
            command = click.get_current_context().command.name
            what = f"{change.key} changes nothing here: `sunspin {command}` does not use it"
            click.echo(f"sunspin: {what}", err=True)


def _among(key: str, names: Iterable[str]) -> bool:
    """Whether a key, or the table that it is in, is one of these."""
    return key in names or re.split(r"[.\[]", key)[0] in names


def print_list(vehicle: str, command: Any, as_json: bool) -> None:
    """Key, value, unit and source of all that a command can change."""
    from sunspin.vehicle.assumptions import AssumptionsFile, assumptions_table
    from sunspin.vehicle.changes import format_value, list_settings
    from sunspin.vehicle.file import VehicleFile, read_vehicle_table

    of_vehicle = list_settings(read_vehicle_table(vehicle), VehicleFile)
    of_study = list_settings(assumptions_table(), AssumptionsFile)
    rows = [each for each in of_vehicle if not _among(each.key, command.idle)]
    rows += [each for each in of_study if _among(each.key, command.uses)]
    if as_json:
        names = ("key", "value", "unit", "source")
        rows = [{name: getattr(each, name) for name in names} for each in rows]
        return click.echo(json.dumps(rows, indent=1))
    width = max(len(each.key) for each in rows)
    for key, value, unit, source, _ in rows:
        about = f"({source})" if source else ""
        click.echo(f"{key:{width}}  {' '.join(filter(None, (format_value(value), unit, about)))}")
