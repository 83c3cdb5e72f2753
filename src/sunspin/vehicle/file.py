"""The form of ``vehicle.toml`` and the way from it to a :class:`~sunspin.vehicle.Vehicle`.

Every physical value may be a bare number (or list) or a table ``{value, sigma, source}``. Unknown keys are refused: a
misspelt key must not silently mean its default.
"""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from sunspin.base.errors import VehicleError, sentence
from sunspin.base.untrusted import read_bytes
from sunspin.vehicle import craft, parts
from sunspin.vehicle.form import Form, Name, Value, scalar, take
from sunspin.vehicle.sensors_file import (
    AttitudeForm,
    ClockForm,
    DisturbanceForm,
    GyroForm,
    MagnetometerForm,
    SunSensorForm,
    read_sensor_forms,
)

MAX_FILE_BYTES = 1_000_000
"""A vehicle file is a page or two of text; what is larger is some other file."""


MAX_DOTS = 1000
"""In one line: Python's reader of TOML takes a time that grows with the square of the parts of a dotted key."""


class BodyForm(Form):
    mass_kg: Value | None = None
    inertia_kg_m2: Value | None = None


class PanelForm(Form):
    name: Name
    normal_B: Value
    cells: Value | None = None
    relative_gain: Value | None = None
    gain_W: Value | None = None
    gain_A: Value | None = None


class SpinDownForm(Form):
    c1_rad_s: Value
    c2_per_s: Value
    c3_rad_s: Value


class FrictionForm(Form):
    coulomb_N_m: Value | None = None
    viscous_N_m_s: Value | None = None
    spin_down: SpinDownForm | None = None


class WheelForm(Form):
    name: Name
    axis_B: Value
    inertia_kg_m2: Value
    speed_rad_s: Value | None = None
    brake_torque_N_m: Value | None = None
    speed_column: Name | None = None
    speed_scale_rad_s: Value | None = None
    friction: FrictionForm | None = None
    alternative_frictions: dict[str, FrictionForm] = {}


class LegForm(Form):
    name: Name
    tip_B_m: Value


class HullForm(Form):
    name: Name
    points_B_m: Value
    panel: Name | None = None


class AntennaForm(Form):
    axis_B: Value
    opening_rad: Value


class SunRuleForm(Form):
    all_dark: Annotated[list[str], Field(min_length=1)]
    reason: Name


class TelemetryTable(Form):
    quantity: Literal["power_W", "current_A"] = "power_W"
    time_column: Name = "time"
    time_format: Literal["utc", "unix", "elapsed"] = "utc"
    epoch_utc: str | None = None
    columns: dict[str, str] = {}
    scale: Value = 1.0
    noise: Value | None = None
    lit_threshold: Value | None = None
    bad_rows: Literal["refuse", "flag"] = "refuse"
    time_scale_s: Value | None = None
    zero: Value | None = None
    wraps_at: Value | None = None
    temperature_columns: dict[str, str] = {}
    temperature_scale: Value | None = None
    temperature_coefficient_per_K: Value | None = None
    reference_temperature_C: Value | None = None


class VehicleForm(Form):
    name: Name
    description: str = ""
    body: BodyForm = BodyForm()
    panel: list[PanelForm] = []
    wheel: list[WheelForm] = []
    leg: list[LegForm] = []
    hull: list[HullForm] = []
    antenna: AntennaForm | None = None
    sun_rule: list[SunRuleForm] = []
    telemetry: TelemetryTable = TelemetryTable()
    sun_sensor: list[SunSensorForm] = []
    gyro: GyroForm | None = None
    attitude: AttitudeForm | None = None
    magnetometer: MagnetometerForm | None = None
    disturbance: DisturbanceForm = DisturbanceForm()
    clock: ClockForm | None = None


GAIN_KEYS = {"cells": None, "relative_gain": None, "gain_W": "W", "gain_A": "A"}
"""Key of a panel's gain -> the unit of the signal it predicts (None: relative)."""


def read_vehicle(source: object) -> craft.Vehicle:
    """Read a built-in vehicle by name or a vehicle file by path; see :func:`sunspin.vehicle.load_vehicle`."""
    if isinstance(source, craft.Vehicle):
        return source
    where = f"built-in vehicle {source!r}" if isinstance(source, str) and source in builtin_names() else str(source)
    return parse_vehicle(vehicle_text(source), where)


def vehicle_text(source: object) -> str:
    """The text of a built-in vehicle's file, by name, or of a vehicle file, by path."""
    if isinstance(source, str) and source in builtin_names():
        return resources.files("sunspin").joinpath("cases", source, "vehicle.toml").read_text(encoding="utf-8")
    if not isinstance(source, str | Path):
        raise VehicleError(sentence("a vehicle is named by a text or a path", got=type(source).__name__))
    return _read_text(Path(source))


def builtin_names() -> list[str]:
    """Names of the vehicles that come with the package."""
    folder = resources.files("sunspin").joinpath("cases")
    return sorted(entry.name for entry in folder.iterdir() if entry.joinpath("vehicle.toml").is_file())


def _read_text(path: Path) -> str:
    known = ", ".join(builtin_names())
    do = f"give the path of a vehicle.toml or a built-in name: {known}"
    try:
        return read_bytes(path, MAX_FILE_BYTES, "vehicle file", VehicleError, do).decode("utf-8")
    except UnicodeDecodeError as error:
        raise VehicleError(
            sentence(f"the file is not UTF-8 text (byte {error.start})", do="save it as UTF-8", where=str(path))
        ) from None


def parse_vehicle(text: str, where: str) -> craft.Vehicle:
    """Turn the text of a vehicle file into a `Vehicle`; `where` names the file in messages."""
    if not text.strip():
        raise VehicleError(sentence("the file is empty", do="`sunspin init DIR` writes one to start from", where=where))
    for number, line in enumerate(text.splitlines(), 1):
        if line.count(".") > MAX_DOTS:
            what = f"the line has more than {MAX_DOTS} decimal points or dots"
            raise VehicleError(sentence(what, do="write it as several lines", where=f"{where}, line {number}"))
    try:
        table = tomllib.loads(text)
        form = VehicleForm.model_validate(table)
        return _vehicle(form)
    except tomllib.TOMLDecodeError as error:
        do = "correct that line"
        if where.lower().endswith(".csv"):
            do = "the vehicle's file, such as vehicle.toml, comes first and the telemetry after it"
        raise VehicleError(sentence(f"this is not valid TOML: {error}", do=do, where=where)) from None
    except RecursionError:
        raise VehicleError(sentence("the file is nested too deeply to be a vehicle file", where=where)) from None
    except ValidationError as error:
        raise VehicleError(_first_problem(error, where)) from None
    except VehicleError as error:
        raise VehicleError(f"{where}: {error}") from None
    except ValueError as error:  # tomllib hands on what int() says of thousands of digits
        raise VehicleError(sentence(f"this is not valid TOML: {error}", do="correct that number", where=where)) from None


def _first_problem(error: ValidationError, where: str) -> str:
    problem = error.errors(include_url=False)[0]
    key = ".".join(f"[{part}]" if isinstance(part, int) else str(part) for part in problem["loc"]).replace(".[", "[")
    if problem["type"] == "extra_forbidden":
        *parents, last = problem["loc"]
        return sentence(f"unknown key {str(last)!r}", do=f"known keys: {_known_keys(parents)}", where=f"{where}, {key}")
    if problem["type"] == "missing":
        return sentence("this key is missing", do="add it", where=f"{where}, {key}")
    message = problem["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    prefix = "should be " if problem["msg"].startswith("Input should be ") else ""
    got = None if isinstance(problem["input"], dict) else problem["input"]
    return sentence(prefix + message, got=got, where=f"{where}, {key}")


def _known_keys(parents: list) -> str:
    """The keys allowed in the table that `parents` leads to."""
    form: Any = VehicleForm
    for part in parents:
        if isinstance(part, int):
            continue
        annotation = form.model_fields[part].annotation if part in getattr(form, "model_fields", {}) else form
        while not (isinstance(annotation, type) and issubclass(annotation, Form)):
            arguments = [item for item in getattr(annotation, "__args__", ()) if item is not type(None)]
            if not arguments:
                return "see the file that `sunspin init` writes"
            annotation = arguments[-1]
        form = annotation
    return ", ".join(form.model_fields)


def _vehicle(form: VehicleForm) -> craft.Vehicle:
    facts: dict[str, parts.Fact] = {}
    panels, gain_unit = _panels(form, facts)
    body = form.body
    return craft.Vehicle(
        name=form.name,
        inertia_kg_m2=take(facts, "body.inertia_kg_m2", body.inertia_kg_m2),
        mass_kg=scalar(facts, "body.mass_kg", body.mass_kg),
        panels=panels,
        wheels=tuple(_wheel(wheel, facts) for wheel in form.wheel),
        legs=tuple(parts.Leg(leg.name, take(facts, f"leg.{leg.name}.tip_B_m", leg.tip_B_m)) for leg in form.leg),
        hull=tuple(
            parts.HullPart(part.name, take(facts, f"hull.{part.name}.points_B_m", part.points_B_m), part.panel)
            for part in form.hull
        ),
        antenna=_antenna(form.antenna, facts),
        sun_rules=tuple(parts.SunRule(tuple(rule.all_dark), rule.reason) for rule in form.sun_rule),
        gain_unit=gain_unit,
        telemetry=_telemetry(form.telemetry, facts),
        sensors=read_sensor_forms(form, facts),
        facts=facts,
    )


def _antenna(form: AntennaForm | None, facts: dict[str, parts.Fact]) -> parts.Antenna | None:
    if form is None:
        return None
    return parts.Antenna(
        take(facts, "antenna.axis_B", form.axis_B), scalar(facts, "antenna.opening_rad", form.opening_rad)
    )


def _panels(form: VehicleForm, facts: dict[str, parts.Fact]) -> tuple[tuple[parts.Panel, ...], str | None]:
    panels, units = [], set()
    for panel in form.panel:
        given = [key for key in GAIN_KEYS if getattr(panel, key) is not None]
        if len(given) != 1:
            raise VehicleError(
                sentence(
                    f"panel {panel.name!r} must give exactly one of {', '.join(GAIN_KEYS)}", got=", ".join(given) or "none"
                )
            )
        units.add(GAIN_KEYS[given[0]])
        gain = scalar(facts, f"panel.{panel.name}.{given[0]}", getattr(panel, given[0]))
        panels.append(parts.Panel(panel.name, take(facts, f"panel.{panel.name}.normal_B", panel.normal_B), gain))
    if len(units) > 1:
        raise VehicleError(sentence("the gains of the panels must all be relative, all gain_W or all gain_A"))
    return tuple(panels), next(iter(units), None)


def _wheel(form: WheelForm, facts: dict[str, parts.Fact]) -> parts.Wheel:
    key = f"wheel.{form.name}"
    inertia = scalar(facts, f"{key}.inertia_kg_m2", form.inertia_kg_m2)
    if not inertia > 0:
        raise VehicleError(sentence(f"{key}.inertia_kg_m2 must be positive", got=inertia))
    friction = parts.Friction() if form.friction is None else _friction(form.friction, inertia, f"{key}.friction", facts)
    return parts.Wheel(
        name=form.name,
        axis_B=take(facts, f"{key}.axis_B", form.axis_B),
        inertia_kg_m2=inertia,
        speed_rad_s=0.0 if form.speed_rad_s is None else scalar(facts, f"{key}.speed_rad_s", form.speed_rad_s),
        friction=friction,
        alternative_frictions={
            name: _friction(other, inertia, f"{key}.alternative_frictions.{name}", facts)
            for name, other in form.alternative_frictions.items()
        },
        brake_torque_N_m=scalar(facts, f"{key}.brake_torque_N_m", form.brake_torque_N_m),
        speed_column=form.speed_column,
        speed_scale_rad_s=scalar(facts, f"{key}.speed_scale_rad_s", form.speed_scale_rad_s) or 1.0,
    )


def _friction(form: FrictionForm, inertia: float, key: str, facts: dict[str, parts.Fact]) -> parts.Friction:
    if form.spin_down is not None:
        if form.coulomb_N_m is not None or form.viscous_N_m_s is not None:
            raise VehicleError(sentence(f"{key} gives both a spin_down and coefficients", do="keep one of them"))
        names = ("c1_rad_s", "c2_per_s", "c3_rad_s")
        values = [scalar(facts, f"{key}.spin_down.{name}", getattr(form.spin_down, name)) for name in names]
        return parts.Friction.from_spin_down(*values, inertia_kg_m2=inertia)
    coefficients = {
        name: 0.0 if getattr(form, name) is None else scalar(facts, f"{key}.{name}", getattr(form, name))
        for name in ("coulomb_N_m", "viscous_N_m_s")
    }
    return parts.Friction(**coefficients)


MORE_NUMBERS = (
    "time_scale_s", "zero", "wraps_at", "temperature_scale", "temperature_coefficient_per_K", "reference_temperature_C",
)  # fmt: skip


def _telemetry(form: TelemetryTable, facts: dict[str, parts.Fact]) -> craft.TelemetryForm:
    scale = 1.0 if isinstance(form.scale, float) else scalar(facts, "telemetry.scale", form.scale)
    noise = scalar(facts, "telemetry.noise", form.noise)
    threshold = scalar(facts, "telemetry.lit_threshold", form.lit_threshold)
    numbers = {key: scalar(facts, f"telemetry.{key}", getattr(form, key)) for key in MORE_NUMBERS}
    positive = {"scale": scale, "noise": noise, "lit_threshold": threshold}
    positive |= {key: numbers[key] for key in ("time_scale_s", "wraps_at", "temperature_scale")}
    for key, value in positive.items():
        if value is not None and not value > 0:
            raise VehicleError(sentence(f"telemetry.{key} must be positive", got=value))
    if form.time_format == "elapsed" and form.epoch_utc is None:
        raise VehicleError(
            sentence("telemetry.time_format is elapsed but telemetry.epoch_utc is missing", do="add the UTC of time zero")
        )
    return craft.TelemetryForm(
        quantity=form.quantity,
        time_column=form.time_column,
        time_format=form.time_format,
        epoch_utc=form.epoch_utc,
        columns=form.columns,
        scale=scale,
        noise=noise,
        lit_threshold=threshold,
        bad_rows=form.bad_rows,
        temperature_columns=form.temperature_columns,
        **{key: value for key, value in numbers.items() if value is not None},
    )
