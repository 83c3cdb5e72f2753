"""Text of options into values; what is no such value is one sentence that names the option."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from typing import TYPE_CHECKING, Any

import click

from sunspin.base.errors import InputError
from sunspin.base.untrusted import SIZES, is_sensible, plain_number

if TYPE_CHECKING:
    import numpy as np

MAX_GRID = 100_000
"""Values of one axis of a scan's grid."""


def strict(kind: click.ParamType) -> click.ParamType:
    """A copy of a click type that refuses empty text, which as a path would be the present folder, forms of numbers that only
    Python knows, and numbers that are infinite, none, or beyond all measure."""
    checked, is_float = copy(kind), isinstance(kind, click.types.FloatParamType)

    def convert(
        value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> Any:
        if isinstance(value, str) and not value.strip():
            checked.fail("the value is empty", parameter, context)
        if isinstance(value, str) and (is_float or isinstance(kind, click.types.IntParamType)):
            if math.isnan(plain_number(value)):
                checked.fail(f"{value!r} is not a valid {kind.name}.", parameter, context)
        number = type(kind).convert(kind, value, parameter, context)
        if is_float and parameter is not None:
            positive = isinstance(kind, click.FloatRange) and kind.min == 0 and kind.min_open
            sizes = SIZES.removeprefix("0 or ") if positive else SIZES
            _check_number(parameter.opts[0], number, sizes)
        return number

    vars(checked).update(convert=convert)
    return checked


def numbers_of(count: int | None = None, deg_s: bool = False) -> Callable[..., Any]:
    """A callback of an option that takes comma-separated numbers, `count` of them if it is given; in rad/s where it takes deg/s."""

    def read(text: str, name: str) -> list[float]:
        values = numbers(text, name, count)
        return [math.radians(each) for each in values] if deg_s else values

    def callback(_: click.Context, parameter: click.Parameter, given: Any) -> Any:
        if isinstance(given, tuple):
            return [read(text, parameter.opts[0]) for text in given]
        return None if given is None else read(given, parameter.opts[0])

    return callback


def grid_of(_: click.Context, parameter: click.Parameter, text: str) -> np.ndarray:
    """The callback of an option that takes a grid, as in `grid`."""
    return grid(text, parameter.opts[0])


def effort(_: click.Context, parameter: click.Parameter, text: str) -> float:
    """A positive number, or infinity."""
    given = math.inf if text == "inf" else plain_number(text)
    if not given > 0:
        raise InputError(
            f"{parameter.opts[0]} must be a positive number or inf",
            got=text,
            do="1 is the usual effort",
        )
    return given


def _check_number(name: str, value: float, sizes: str = SIZES) -> None:
    if not is_sensible(value):
        raise InputError(f"{name} must be {sizes}", got=str(value))


EXAMPLE = ("0.1", "0", "-0.2", "1", "0.5", "0.02")
"""Numbers of an option, as many as it takes."""

WHEN = "s from the epoch, or UTC such as 2014-11-12T16:20"


def numbers(text: str | None, name: str, count: int | None = None, form: str = "") -> list[float]:
    """Comma-separated numbers of an option; `form`: what it takes, where that is not only numbers."""
    values = [plain_number(part) for part in text.split(",")] if text else []
    none = any(map(math.isnan, values))
    if not none:
        for value in values:
            _check_number(name, value)
    if none or (count is not None and len(values) != count):
        wanted = form or (
            "a number" if count == 1 else f"{count or ''} numbers separated by commas".lstrip()
        )
        do = (
            None
            if form
            else f"for example {name}{'=' if name.startswith('--prior ') else ' '}{','.join(EXAMPLE[: count or 3])}"
        )
        raise InputError(f"{name} takes {wanted}", got=text or "nothing", do=do)
    return values


def grid(text: str, name: str) -> np.ndarray:
    """low:high:step in deg/s, or values separated by commas; the result is in rad/s."""
    import numpy as np

    from sunspin.estimate.scan.volume import check_size

    if ":" not in text:
        return np.radians(numbers(text, name))
    parts, do = text.split(":"), f"for example {name}=-6:6:1"
    low, high, step = numbers(",".join(parts), name, 3) if len(parts) == 3 else (0, 0, 0)
    count = (high - low) / step + 1 if step > 0 and high >= low else math.nan
    if not math.isfinite(count):
        what = f"{name} must be low:high:step in deg/s, low to high and with a positive step"
        raise InputError(what, got=text, do=do)
    if count > MAX_GRID:
        check_size(count, 1, 1)
        what = f"{name} has {count:.3g} values, more than {MAX_GRID}"
        raise InputError(what, got=text, do="use a larger step")
    steps = round((high - low) / step)
    return np.radians(np.linspace(low, low + step * steps, steps + 1))


def vertical(text: str | None) -> Any:
    """The name of a rule, rad about legs-down, or a direction."""
    if text is None or text in ("legs_down", "any"):
        return text
    values = numbers(text, "--vertical")
    if len(values) == 1:
        return math.radians(values[0])
    if len(values) == 3:
        return tuple(values)
    raise InputError("--vertical takes legs_down, any, an angle in degrees or x,y,z", got=text)


def prior(text: str) -> tuple[str, float]:
    """KEY=SIGMA."""
    key, _, value = text.partition("=")
    return key.strip(), numbers(value, f"--prior {key.strip()}", 1)[0]


def observation(kind: str, text: str) -> dict[str, Any]:
    """T,VALUE,SIGMA of an angular speed or T,X,Y,Z,SIGMA of a body rate, in deg/s; the result is in rad/s."""
    t, *value, sigma = numbers(text, f"--{kind}-deg-s", {"rate": 3, "gyro": 5}[kind])
    value = [math.radians(each) for each in value]
    return {"kind": kind, "t_s": t, "value": value, "sigma": math.radians(sigma)}


def field(text: str) -> dict[str, Any]:
    """T,X,Y,Z,ANGLE,SIGMA of a magnetic direction."""
    t, x, y, z, angle, sigma = numbers(text, "--field", 6)
    return {"kind": "field", "t_s": t, "value": [x, y, z], "angle_rad": angle, "sigma": sigma}


def period(text: str, epoch_utc: str | None) -> Any:
    """SECONDS+-SIGMA@TIME of a period seen."""
    from sunspin.estimate.terms.period import Period

    value, _, rest = text.partition("+-")
    sigma, _, when = rest.partition("@")
    if not (value and sigma and when):
        raise InputError(
            "--period takes SECONDS+-SIGMA@TIME",
            got=text,
            do="for example --period 13.0+-0.5@15:50",
        )
    return Period(
        next(iter(times(when, epoch_utc, "--period"))), *numbers(f"{value},{sigma}", "--period", 2)
    )


def periods_of(texts: tuple[str, ...], telemetry: Any) -> list[Any]:
    """All of --period, on the telemetry's clock."""
    return [period(text, telemetry.attrs.get("epoch_utc")) for text in texts]


def times(text: str, epoch_utc: str | None, option: str = "--predict") -> dict[float, str]:
    """s from the epoch -> what was asked for, in order of time."""
    from sunspin.vehicle.timeline import utc_seconds

    times = {}
    for part in (piece.strip() for piece in text.split(",")):
        if ":" not in part:
            times[numbers(part, option, 1, WHEN)[0]] = f"{part} s"
        elif epoch_utc is None:
            raise InputError("the telemetry has no epoch, so a time must be in s", got=part)
        else:
            utc = part if "T" in part else f"{epoch_utc[:10]}T{part}"
            times[utc_seconds(utc, epoch_utc)] = f"{utc.rstrip('Z')} UTC"
    return dict(sorted(times.items()))


def between(samples: Any, begin: str | None, end: str | None) -> Any:
    """The samples from one time to another."""
    import numpy as np

    from sunspin.vehicle.timeline import utc_after

    first, last = instants_of(samples, begin, end)
    t = samples["time"].values
    inside = (t >= (-np.inf if first is None else first)) & (
        t <= (np.inf if last is None else last)
    )
    if not inside.any():
        there = " to ".join(utc_after(float(at), samples.attrs["epoch_utc"]) for at in t[[0, -1]])
        got = f"{begin or 'the beginning'} to {end or 'the end'}"
        raise InputError(
            "no samples lie between --from and --to", got=got, do=f"the file has {there}"
        )
    return samples.isel(time=np.flatnonzero(inside))


def instants_of(
    samples: Any, begin: str | None, end: str | None
) -> tuple[float | None, float | None]:
    """Seconds from the epoch of --from and --to, None where they are not given."""
    epoch = samples.attrs["epoch_utc"]
    return (
        None if begin is None else instant(begin, "--from", epoch),
        None if end is None else instant(end, "--to", epoch),
    )


def instant(text: str, option: str, epoch_utc: str) -> float:
    """Seconds from the epoch of a time in UTC, or in seconds from there."""
    from sunspin.vehicle.timeline import utc_seconds

    return (
        utc_seconds(text, epoch_utc)
        if ":" in text or "T" in text
        else numbers(text, option, 1, WHEN)[0]
    )
