"""Keys of ``vehicle.toml``, and its conversion to a :class:`~sunspin.vehicle.Vehicle`.

Every physical value may be a number (or list) or a value table ``{value, sigma, source}``. Unknown keys are refused, so that a
misspelt key cannot mean its default without a message.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from sunspin.base.errors import VehicleError, printable
from sunspin.base.untrusted import decode_text, read_bytes, read_toml
from sunspin.vehicle import craft, parts, sensors
from sunspin.vehicle.changes import Change, Changes, Setting, apply_changes, parse_changes
from sunspin.vehicle.part import Name, Part, describe_error, keys_of, numbers, part

MAX_FILE_BYTES = 1_000_000
"""A vehicle file is a page or two of text; a larger file is a different one."""


@part
class BodyTable(Part):
    """The table [body]."""

    mass_kg: craft.Mass | None = None
    inertia_kg_m2: craft.Inertia | None = None


@part
class VehicleFile(Part):
    """The tables of a vehicle file; each is a part or a list of parts."""

    name: Name
    description: str = ""
    body: BodyTable = BodyTable()
    panel: tuple[parts.Panel, ...] = ()
    wheel: tuple[parts.Wheel, ...] = ()
    leg: tuple[parts.Leg, ...] = ()
    hull: tuple[parts.HullPart, ...] = ()
    antenna: parts.Antenna | None = None
    orbit: parts.StatedOrbit | None = None
    sun_rule: tuple[parts.SunRule, ...] = ()
    telemetry: craft.TelemetryForm = craft.TelemetryForm()
    sun_sensor: tuple[sensors.SunSensor, ...] = ()
    sun_vector: sensors.SunVector | None = None
    gyro: sensors.Gyro | None = None
    rate_size: sensors.RateSize | None = None
    attitude: sensors.Attitude | None = None
    magnetometer: sensors.Magnetometer | None = None
    disturbance: sensors.Disturbance = sensors.Disturbance()
    clock: sensors.Clock | None = None
    panel_response: parts.ResponseForm = parts.ResponseForm()
    channel: tuple[parts.Channel, ...] = ()


class ChangedFile(NamedTuple):
    """A vehicle file with changes, accepted instead of a name or a path."""

    source: object
    changes: tuple[Change, ...]


def read_vehicle(source: object, changes: Changes = None) -> craft.Vehicle:
    """Read a built-in vehicle by name or a vehicle file by path; see :func:`sunspin.vehicle.load_vehicle`.

    A `ChangedFile` has its own changes, and `changes` is not used. A `Vehicle` is returned as it is; with changes it raises
    `VehicleError`.
    """
    if isinstance(source, ChangedFile):
        source, changes = source.source, source.changes
    all_changes = parse_changes(changes)
    if isinstance(source, craft.Vehicle):
        if all_changes:
            raise VehicleError(
                "changes are made to a vehicle's file", do="give its name or its path with them"
            )
        return source
    return parse_vehicle(read_vehicle_text(source), describe_source(source), all_changes)


def attach_changes(source: object, changes: tuple[Change, ...]) -> object:
    """Return a vehicle's name or path, combined with its changes if there are any."""
    return ChangedFile(source, changes) if changes else source


def describe_source(source: object) -> str:
    """Return a vehicle file in words, for messages."""
    return (
        f"built-in vehicle {source!r}"
        if isinstance(source, str) and source in builtin_names()
        else str(source)
    )


def read_vehicle_text(source: object) -> str:
    """Read the text of a vehicle file, given by name or path.

    For a `ChangedFile` the text has its changes, which are listed in comments at the top.
    """
    if isinstance(source, ChangedFile):
        import tomlkit

        # first a fast reader, which refuses files that would take tomlkit very long
        read_vehicle_table(source.source)
        document = tomlkit.parse(read_vehicle_text(source.source))
        settings = apply_changes(document, source.changes)
        header = [f"# {source.source} with changes for one run:"]
        header += [f"#   {setting}" for setting in settings]
        return "\n".join(printable(line) for line in header) + "\n" + tomlkit.dumps(document)
    if isinstance(source, str) and source in builtin_names():
        return (
            resources.files("sunspin")
            .joinpath("cases", source, "vehicle.toml")
            .read_text(encoding="utf-8")
        )
    if not isinstance(source, str | Path):
        raise VehicleError("a vehicle is named by a text or a path", got=type(source).__name__)
    return _read_text(Path(source))


def read_vehicle_table(source: object) -> dict[str, Any]:
    """Read the parsed TOML of a vehicle file."""
    return read_toml(read_vehicle_text(source), describe_source(source), VehicleError)


def builtin_names() -> list[str]:
    """Return the names of the vehicles that come with the package."""
    folder = resources.files("sunspin").joinpath("cases")
    return sorted(
        entry.name for entry in folder.iterdir() if entry.joinpath("vehicle.toml").is_file()
    )


def _read_text(path: Path) -> str:
    """Read the text of a vehicle file by path."""
    known = ", ".join(builtin_names())
    do = f"give the path of a vehicle.toml or a built-in name: {known}"
    return decode_text(
        read_bytes(path, MAX_FILE_BYTES, "vehicle file", VehicleError, do),
        str(path),
        VehicleError,
        "save it as UTF-8",
    )


def parse_vehicle(text: str, where: str, changes: tuple[Change, ...] = ()) -> craft.Vehicle:
    """Build a `Vehicle` from the text of a vehicle file and changes; `where` names the file in messages."""
    if not text.strip():
        raise VehicleError(
            "the file is empty", do="`sunspin init DIR` writes one to start from", where=where
        )
    do = "correct that line"
    if where.lower().endswith(".csv"):  # a likely mistake: vehicle and telemetry in the wrong order
        do = "the vehicle's file, such as vehicle.toml, comes first and the telemetry after it"
    table = read_toml(text, where, VehicleError, do)
    settings = apply_changes(table, changes)
    if settings:
        where = f"{where} with {', '.join(each.key for each in settings)} set"
    try:
        return _build_vehicle(table, settings)
    except RecursionError:
        raise VehicleError(
            "the file is nested too deeply to be a vehicle file", where=where
        ) from None
    except ValidationError as error:
        raise VehicleError(describe_error(error, VehicleFile, where, table)) from None
    except VehicleError as error:
        raise VehicleError(f"{where}: {error}") from None


def _build_vehicle(table: dict[str, Any], settings: tuple[Setting, ...]) -> craft.Vehicle:
    """Build a vehicle from a parsed file; `settings` lists the changes made to it.

    Raises `VehicleError` or pydantic's `ValidationError` if the file is not valid.
    """
    for law in {"grazing", "wall"}.intersection(table.get("panel_response", ())):
        what = f"panel_response.{law} is gone: a panel gives its gain times the cosine"
        raise VehicleError(what, do=f"leave out [panel_response.{law}]")
    file = TypeAdapter(VehicleFile).validate_python(
        table, context="file", by_alias=True, by_name=False
    )
    # units of the gains, one if the file is valid; None for the two keys of relative gains
    units = {
        unit
        for panel in table.get("panel", ())
        for key, unit in parts.GAIN_UNITS.items()
        if key in panel
    }
    if len(units) > 1:
        raise VehicleError("the gains of the panels must all be relative, all gain_W or all gain_A")
    # Sun sensors are a list of tables; the other sensors have one table each, with the name of the field
    other_sensors = {
        key: getattr(file, key) for key in keys_of(sensors.Sensors) if key != "sun_sensors"
    }
    return craft.Vehicle(
        name=file.name,
        inertia_kg_m2=file.body.inertia_kg_m2,
        mass_kg=file.body.mass_kg,
        panels=file.panel,
        wheels=file.wheel,
        legs=file.leg,
        hull=file.hull,
        antenna=file.antenna,
        orbit=file.orbit,
        sun_rules=file.sun_rule,
        gain_unit=next(iter(units), None),
        telemetry=file.telemetry,
        sensors=sensors.Sensors(file.sun_sensor, **other_sensors),
        panel_response=file.panel_response,
        channels=file.channel,
        facts=dict(_list_facts(table)),
        changes=settings,
    )


def _list_facts(table: dict[str, Any], where: str = "") -> Iterator[tuple[str, parts.Fact]]:
    """Yield every number (or list of numbers) of a valid file with its sigma and source, by its path.

    Parts of a list are named in the path. Texts and truth values are not facts.
    """
    for key, item in table.items():
        if isinstance(item, dict) and not isinstance(item.get("value"), int | float | list):
            yield from _list_facts(item, f"{where}{key}.")
        elif isinstance(item, dict):  # a value table
            sigma = None if item.get("sigma") is None else numbers(item["sigma"])
            yield f"{where}{key}", parts.Fact(numbers(item["value"]), sigma, item.get("source"))
        elif isinstance(item, list) and all(isinstance(each, dict) for each in item):
            for each in item:
                yield from _list_facts(each, f"{where}{key}.{each.get('name')}.")
        elif not isinstance(item, str | bool) and not (
            isinstance(item, list) and isinstance(item[0], str)  # a list of names
        ):
            yield f"{where}{key}", parts.Fact(numbers(item))


def find_line(text: str, table: str, key: str) -> tuple[int, str] | None:
    """Return number and text of the line of a vehicle file with a key of a table, else of the table's header, else None.

    If several tables have this name, it is the first line with the key, or the first header.
    """
    header, in_table = None, False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("["):
            in_table = line.split("#")[0].strip().strip("[] ") == table.strip("[]")
            header = header or ((number, line.strip()) if in_table else None)
        elif in_table and line.split("=")[0].strip() == key:
            return number, line.strip()
    return header
