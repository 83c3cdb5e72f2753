"""The option --set, its short names, the list of keys that it accepts, and the inputs with the changes applied."""

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


class ShortOption(NamedTuple):
    """A short option: the key that it sets, and its help."""

    key: str
    help: str


SHORT_OPTIONS = {
    "friction": ShortOption(
        "wheel.friction",
        "Wheel-friction law, by name in the vehicle file, e.g. `printed`.",
    ),
    "wheel_speed": ShortOption(
        "wheel.speed_rad_s", "Wheel speed at the first sample after touchdown, rad/s."
    ),
    "lead": ShortOption("study.lead_s", "Time from the first touchdown to the next sample, s."),
    "target_weights": ShortOption(
        "study.target_weights",
        "Weights of the measured Sun directions: equal, or interval (by the time between samples).",
    ),
    "mask": ShortOption(
        "study.mask",
        "Simulated Sun directions that count: reconstructible (from the panels) or everywhere (all).",
    ),
    "factor": ShortOption(
        "study.near_minimum_factor", "The paper's set: EMD below this times the smallest."
    ),
    "confidence": ShortOption(
        "study.confidence", "Confidence level of --candidates scan, e.g. 0.9."
    ),
    "restitution": ShortOption(
        "collision.restitution", "Coefficient of restitution (0 = sticking)."
    ),
    "damper": ShortOption(
        "collision.damper", "Fraction of the body-z impulse that the landing gear absorbs."
    ),
}
"""Name of each short option -> the key that it sets, and its help."""

LANDING_KEYS = ("body.mass_kg", "leg", "hull", "antenna")
"""Keys and tables of a vehicle file that only collisions and landings use."""

TELEMETRY_KEYS = (
    "telemetry",
    "channel",
    "sun_sensor",
    "sun_vector",
    "gyro",
    "rate_size",
    "attitude",
    "magnetometer",
)
TELEMETRY_KEYS += ("clock", "disturbance", "orbit")
"""Tables of a vehicle file that only commands with telemetry use."""

PANEL_KEYS = ("panel", "panel_response", "sun_rule", *TELEMETRY_KEYS)
"""Those tables and the tables of panels."""


class Inputs(NamedTuple):
    """Inputs of a command with the changes of --set.

    `file`: the vehicle file with its changes, which is saved with the results; `craft`: the vehicle; `assumptions`: those of the
    study.
    """

    file: Any
    craft: Vehicle
    assumptions: Assumptions

    @property
    def changes(self) -> tuple[Any, ...]:
        """Changes of vehicle and assumptions."""
        return (*self.craft.changes, *self.assumptions.changes)

    def record_changes(self, result: Any) -> Any:
        """Write all changes into the attributes of a result, and return the result."""
        if self.changes:
            result.attrs["changes"] = "\n".join(map(str, self.changes))
        return result


class Command(click.Command):
    """A command of sunspin.

    Texts of arguments are checked before they are converted. `--set list` needs no other argument. A command that fails leaves no
    empty results folder.
    """

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; if it fails, remove the results folders that it created and left empty."""
        module = "sunspin.output.folder"  # if it was not imported, no folder was created
        try:
            result = super().invoke(ctx)
        except BaseException:  # including interruptions
            if module in sys.modules:
                sys.modules[module].remove_empty_folders()
            raise
        if module in sys.modules:
            sys.modules[module].keep_folders()
        return result

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Check the texts of all arguments, answer `--set list`, and parse the arguments."""
        if ctx.resilient_parsing:  # a shell completes a line that is not finished
            return super().parse_args(ctx, args)
        given = self.make_parser(ctx).parse_args(args=list(args))[
            0
        ]  # name of parameter -> text or texts
        for parameter in self.params:
            values = given.get(parameter.name)
            for text in values if isinstance(values, list | tuple) else (values,):
                check_text(text, parameter, ctx)
        if "list" in given.get("sets", ()):
            vehicle = given.get("vehicle")
            if not isinstance(vehicle, str):  # left out: click gives a value of its own
                vehicle = "philae"
            print_settings(vehicle, self.callback, bool(given.get("as_json")))
            ctx.exit()
        return super().parse_args(ctx, args)


def set_options(*uses: str, short: tuple[str, ...] = (), idle: tuple[str, ...] = ()) -> Callable:
    """Return a decorator that adds --set and short options to a command, which receives all changes as `changes`.

    A change is refused if another option sets the same key, or if the command does not use that assumption of the study. A change
    of the vehicle file that the command does not use is accepted with a warning (`load_inputs`).

    Parameters
    ----------
    uses : keys or tables of the assumptions that the command uses
    short : short options of the command, names in `SHORT_OPTIONS`
    idle : keys or tables of the vehicle file that the command does not use
    """
    help_text = (
        "Override a value of the vehicle file or the study for this run: KEY=VALUE, KEY*=FACTOR or "
        "KEY+=STEP. `--set list` prints all keys. Repeatable."
    )

    def decorate(function: Any) -> Callable:
        @wraps(function)
        def command(sets: tuple[str, ...], **given: Any) -> None:
            from sunspin.vehicle.assumptions import TABLES as ASSUMPTION_TABLES
            from sunspin.vehicle.assumptions import read_assumptions
            from sunspin.vehicle.changes import parse_changes

            source = click.get_current_context().get_parameter_source
            typed = [name for name in given if source(name) is ParameterSource.COMMANDLINE]
            option_of_key = {
                SHORT_OPTIONS[name].key: name for name in typed if name in SHORT_OPTIONS
            }
            changes = parse_changes(sets)
            for change in changes:
                key_without_indices = re.sub(r"\[[^\]]*\]", "", change.key)
                if name := option_of_key.get(key_without_indices):
                    what = f"--{name.replace('_', '-')} and --set {change.key} say the same thing"
                    raise InputError(what, do="give one of them")
                # an assumption of the study that is not used; keys of the vehicle file are checked by `load_inputs`
                if _is_listed(change.key, ASSUMPTION_TABLES) and not _is_listed(change.key, uses):
                    # raises an error with the nearest name if the key is misspelt
                    read_assumptions([change])
                    what, do = "this command does not use that assumption", "`--set list` shows all"
                    raise InputError(what, got=change.key, do=do)
            # the short options become changes of their keys
            values = [(SHORT_OPTIONS[name].key, given.pop(name)) for name in short]
            option_changes = [f"{key}={value}" for key, value in values if value is not None]
            function(changes=parse_changes(option_changes) + changes, **given)

        decorated: Any = command
        for name in reversed(short):
            decorated = click.option(f"--{name.replace('_', '-')}", help=SHORT_OPTIONS[name].help)(
                decorated
            )
        # `Command` and `warn_unused` read these attributes of the callback
        vars(decorated).update(uses=uses, idle=idle)
        option = click.option("--set", "sets", multiple=True, metavar="KEY=VALUE", help=help_text)
        return option(decorated)

    return decorate


def load_inputs(vehicle: Any, changes: Iterable[Change]) -> Inputs:
    """Load a vehicle and the assumptions of the study with changes, and warn of changes that the command does not use."""
    from sunspin.vehicle import load_vehicle
    from sunspin.vehicle.assumptions import read_assumptions, split_changes
    from sunspin.vehicle.file import attach_changes

    of_vehicle, of_study = split_changes(changes)
    file = attach_changes(vehicle, of_vehicle)
    craft, assumptions = load_vehicle(file), read_assumptions(of_study)
    # the keys that the command does not use; none if no command runs, as in Python
    context = click.get_current_context(silent=True)
    callback = None if context is None else context.command.callback
    warn_unused(changes, getattr(callback, "idle", ()))
    return Inputs(file, craft, assumptions)


def warn_unused(changes: Iterable[Any], idle: tuple[str, ...]) -> None:
    """Print on standard error which changes have no effect, because their keys or tables are in `idle`."""
    for change in changes:
        if _is_listed(change.key, idle):
            command = click.get_current_context().command.name
            what = f"{change.key} changes nothing here: `sunspin {command}` does not use it"
            click.echo(f"sunspin: {what}", err=True)


def _is_listed(key: str, names: Iterable[str]) -> bool:
    """Return whether a key such as `panel[0].gain_W`, or its table `panel`, is one of `names`."""
    return key in names or re.split(r"[.\[]", key)[0] in names


def print_settings(vehicle: str, callback: Any, as_json: bool) -> None:
    """Print key, value, unit and source of everything that a command can change.

    `callback` is the function of the command, to which `set_options` has given the attributes `idle` and `uses`.
    """
    from sunspin.vehicle.assumptions import AssumptionsFile, assumptions_table
    from sunspin.vehicle.changes import format_value, list_settings
    from sunspin.vehicle.file import VehicleFile, read_vehicle_table

    of_vehicle = list_settings(read_vehicle_table(vehicle), VehicleFile)
    of_study = list_settings(assumptions_table(), AssumptionsFile)
    rows = [row for row in of_vehicle if not _is_listed(row.key, callback.idle)]
    rows += [row for row in of_study if _is_listed(row.key, callback.uses)]
    if as_json:
        names = ("key", "value", "unit", "source")
        entries = [{name: getattr(row, name) for name in names} for row in rows]
        return click.echo(json.dumps(entries, indent=1))
    width = max(len(row.key) for row in rows)
    for key, value, unit, source, _ in rows:
        origin = f"({source})" if source else ""
        click.echo(f"{key:{width}}  {' '.join(filter(None, (format_value(value), unit, origin)))}")
