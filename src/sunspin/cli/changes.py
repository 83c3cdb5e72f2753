"""The option --set, its short names, and the list of what can be set."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from sunspin.base.errors import InputError, sentence

if TYPE_CHECKING:
    from sunspin.vehicle import Vehicle
    from sunspin.vehicle.assumptions import Assumptions

SHORT = {
    "friction": (
        "wheel.friction",
        "NAME",
        "Wheel friction by the name of another law in the vehicle file, such as printed.",
    ),
    "wheel_speed": (
        "wheel.speed_rad_s",
        "RAD_S",
        "Wheel speed at the first sample after the touchdown.",
    ),
    "lead": ("study.lead_s", "S", "From the first touchdown to the first sample after it."),
    "target_weights": (
        "study.target_weights",
        "equal|interval",
        "What each measured direction counts.",
    ),
    "mask": ("study.mask", "reconstructible|everywhere", "Which simulated directions count."),
    "factor": ("study.near_minimum_factor", "FACTOR", "Near-minimum factor of the paper's set."),
    "confidence": ("study.confidence", "SHARE", "Of the calibrated set."),
    "restitution": ("collision.restitution", "SHARE", "Of the collision: 0 sticks."),
    "damper": (
        "collision.damper",
        "SHARE",
        "Part of the blow that the landing gear takes along z.",
    ),
}
"""Option -> key that it is a name for, its value, its help."""


class Opened(NamedTuple):
    """What a command works with: the vehicle file (with changes), the vehicle, the assumptions, in words what was changed."""

    file: Any
    craft: Vehicle
    assumptions: Assumptions
    said: tuple[str, ...]

    def mark(self, result: Any) -> Any:
        """The result, saying in its attributes all that was changed."""
        if self.said:
            result.attrs["changes"] = "\n".join(self.said)
        return result


class Changeable(click.Command):
    """A command with --set: `--set list` needs nothing else but the vehicle."""

    @property
    def uses(self) -> tuple[str, ...]:
        return getattr(self.callback, "uses", ())

    @property
    def idle(self) -> tuple[str, ...]:
        return getattr(self.callback, "idle", ())

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if any(word in ("list", "--set=list") for word in args):
            given, _, _ = self.make_parser(ctx).parse_args(args=list(args))
            if "list" in given.get("sets", ()):
                vehicle = given.get(
                    "vehicle"
                )  # neither None nor a text where an argument is missing
                _print_list(
                    vehicle if isinstance(vehicle, str) else "philae",
                    self.uses,
                    self.idle,
                    bool(given.get("as_json")),
                )
                ctx.exit()
        return super().parse_args(ctx, args)


LANDING = ("body.mass_kg", "leg", "hull", "antenna")
"""What only collisions and landings use of a vehicle file."""

READING = (
    "telemetry",
    "channel",
    "sun_sensor",
    "sun_vector",
    "gyro",
    "attitude",
    "magnetometer",
    "clock",
    "disturbance",
    "orbit",
)
"""What only those use who read telemetry."""

SEEING = ("panel", "panel_response", "sun_rule", *READING)
"""The same with the panels, which also say for whom the printed lines were found."""


def set_options(*uses: str, short: tuple[str, ...] = (), idle: tuple[str, ...] = ()) -> Callable:
    """--set and some of its short names; `uses`: keys of the assumptions, or tables of them, that the command uses; `idle`: keys or
    tables of the vehicle file that it does not use, which is said where one of them is changed."""

    def decorate(command: Any) -> Callable:
        for name in reversed(short):
            _, value, about = SHORT[name]
            command = click.option(f"--{name.replace('_', '-')}", metavar=value, help=about)(
                command
            )
        command = click.option(
            "--set",
            "sets",
            multiple=True,
            metavar="KEY=VALUE",
            help="Change an assumption for this run, by its key in the "
            "vehicle file: KEY=VALUE, KEY*=FACTOR or KEY+=STEP; `--set list` shows what can be set. Repeatable.",
        )(command)
        vars(command).update(uses=uses, idle=idle)
        return command

    return decorate


def asked(sets: tuple[str, ...], uses: tuple[str, ...], **short: str | None) -> tuple[Any, ...]:
    """All changes asked for; refused is one of an assumption that the command does not use."""
    from sunspin.vehicle.assumptions import TABLES, read_assumptions
    from sunspin.vehicle.changes import changes_of

    given = {SHORT[name][0]: name for name, value in short.items() if value is not None}
    changes = changes_of([*(f"{key}={short[name]}" for key, name in given.items()), *sets])
    for change in changes[len(given) :]:
        if change.key in given:
            raise _twice(change.key, f"--{given[change.key].replace('_', '-')}")
    for change in changes:
        table = change.key.partition(".")[0]
        if table in TABLES and table not in uses and change.key not in uses:
            read_assumptions([change])  # a misspelt one is refused with the nearest name
            raise InputError(
                sentence(
                    "this command does not use that assumption",
                    got=change.key,
                    do=_instead(change.key),
                )
            )
    return changes


def _instead(key: str) -> str:
    """The command's own option for an assumption, if it has one."""
    context = click.get_current_context(silent=True)
    options = [] if context is None else [parameter.name for parameter in context.command.params]
    own = [name for name, (of, *_) in SHORT.items() if of == key and name in options]
    return f"give --{own[0]}" if own else "`--set list` shows all"


def _twice(key: str, option: str) -> InputError:
    return InputError(
        sentence(f"{option} and --set {key} say the same thing", do="give one of them")
    )


def once(made: Opened, **options: Any) -> None:
    """Refuse an option, by its name, that says again what --set has changed: with the key that it stands for, if it was given."""
    keys = {one.key for one in (*made.craft.changes, *made.assumptions.changes)}
    for name, (key, given) in options.items():
        same = [
            one
            for one in keys
            if one == key or (one.startswith("wheel") and one.partition(".")[2] == key)
        ]
        if given is not None and same:
            raise _twice(same[0], f"--{name.replace('_', '-')}")


def say_idle(changes: Iterable[Any], idle: tuple[str, ...] | None = None) -> None:
    """Say, beside the output, which changes have no effect: those of `idle` keys or tables, unless given the command's own."""
    context = click.get_current_context(silent=True)
    if context is None:
        return
    own = getattr(context.command, "idle", ())
    for change in changes:
        if _is_idle(change.key, own if idle is None else idle):
            click.echo(
                f"sunspin: {change.key} changes nothing here: `sunspin {context.command.name}` does not use it",
                err=True,
            )


def _is_idle(key: str, idle: tuple[str, ...]) -> bool:
    return key in idle or key.partition(".")[0].partition("[")[0] in idle


def opened(vehicle: Any, sets: tuple[str, ...], *uses: str, **short: str | None) -> Opened:
    """The vehicle and the assumptions with the changes; which of them the command does not use is said."""
    from sunspin.vehicle import load_vehicle
    from sunspin.vehicle.assumptions import read_assumptions, split
    from sunspin.vehicle.file import changed_file

    changes = asked(sets, uses, **short)
    of_vehicle, of_study = split(changes)
    file = changed_file(vehicle, of_vehicle)
    craft, assumptions = load_vehicle(file), read_assumptions(of_study)
    say_idle(changes)
    return Opened(file, craft, assumptions, tuple(map(str, (*craft.changes, *assumptions.changes))))


def _print_list(vehicle: str, uses: tuple[str, ...], idle: tuple[str, ...], as_json: bool) -> None:
    """Key, value, unit and source of all that the command can change."""
    from sunspin.vehicle.assumptions import LEFT_OUT, AssumptionsFile, assumptions_table
    from sunspin.vehicle.changes import settings, shown
    from sunspin.vehicle.file import VehicleFile, vehicle_table

    found = [
        one for one in settings(vehicle_table(vehicle), VehicleFile) if not _is_idle(one.key, idle)
    ]
    for one in settings(assumptions_table(), AssumptionsFile):
        if one.key in uses or one.key.partition(".")[0] in uses:
            found.append(one._replace(source=LEFT_OUT.get(one.key, one.source)))
    if as_json:
        click.echo(json.dumps([one._asdict() for one in found], indent=1))
        return
    width = max(len(one.key) for one in found)
    for one in found:
        about = f"({one.source})" if one.source else ""
        click.echo(
            f"{one.key:{width}}  {' '.join(filter(None, (shown(one.value), one.unit, about)))}"
        )
