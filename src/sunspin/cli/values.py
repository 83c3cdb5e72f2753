"""Conversion of the texts of options to values. The errors name the option."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from sunspin.base.errors import InputError
from sunspin.base.untrusted import SIZES, is_sensible, plain_number

if TYPE_CHECKING:
    import numpy as np

MAX_GRID = 100_000
"""Largest number of values of one axis of a scan's grid."""

EXAMPLE = ("0.1", "0", "-0.2", "1", "0.5", "0.02")
"""Numbers for the examples in error messages; an option takes the first ones."""

WHEN = "s from the epoch, or UTC such as 2014-11-12T16:20"
"""Form of a time in error messages."""


class Parsed(click.ParamType):
    """A type of options whose value a function `parse` makes from the text and the name of the option.

    `metavar` stands for the text in --help, such as "X,Y,Z".
    """

    def __init__(self, parse: Callable[[str, str], Any], metavar: str = "text") -> None:
        self.parse, self.name = parse, metavar

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value of the text `value` that was given for the option `param`."""
        return self.parse(value, param.opts[0] if param else "the option")


def check_text(text: Any, parameter: click.Parameter, context: click.Context) -> None:
    """Raise an error if the text of an option or argument is empty, or if it should be a number and is not a plain decimal.

    Python reads more texts as numbers than people write, such as 1_000. A float must also be zero or of a sensible size (`SIZES`).
    """
    if not isinstance(text, str):  # not given, or a flag
        return
    if not text.strip():  # as a path, it would be the current folder
        raise click.BadParameter("the value is empty", context, parameter)
    kind = parameter.type
    is_float = isinstance(kind, click.types.FloatParamType)
    if is_float or isinstance(kind, click.types.IntParamType):
        number = plain_number(text)
        if math.isnan(number):
            raise click.BadParameter(f"{text!r} is not a valid {kind.name}.", context, parameter)
        if is_float:
            # 0 is outside the range of such an option, so that the error does not offer it
            excludes_0 = isinstance(kind, click.FloatRange) and kind.min == 0
            sizes = SIZES.removeprefix("0 or ") if excludes_0 else SIZES
            _check_number(parameter.opts[0], number, sizes)


def _check_number(name: str, value: float, sizes: str = SIZES) -> None:
    """Raise `InputError` if a number is infinite, NaN, or too large or small; `sizes`: the allowed sizes in words."""
    if not is_sensible(value):
        raise InputError(f"{name} must be {sizes}", got=str(value))


def parse_numbers(
    text: str, name: str, count: int | None = None, expected: str = "", separator: str = " "
) -> list[float]:
    """Return the comma-separated numbers of the option `name`; an empty list for an empty text if `count` is None.

    Parameters
    ----------
    count : int, optional
        How many numbers there must be; by default any number of them.
    expected : str, optional
        What the option takes, for the error, if that is not only numbers. The error then gives no example.
    separator : str
        Stands between the name of the option and its text in the error's example.

    Raises
    ------
    InputError
        A part is no plain number or is too large or small (`SIZES`), or there are not `count` numbers.
    """
    values = [plain_number(part) for part in text.split(",")] if text else []
    if any(map(math.isnan, values)) or count not in (None, len(values)):
        several = f"{count or ''} numbers separated by commas".lstrip()
        what = f"{name} takes {expected or ('a number' if count == 1 else several)}"
        example = f"for example {name}{separator}{','.join(EXAMPLE[: count or 3])}"
        raise InputError(what, got=text or "nothing", do=None if expected else example)
    for value in values:
        _check_number(name, value)
    return values


def parse_rate(text: str, name: str) -> list[float]:
    """Return a body rate (3) in rad/s from a text in deg/s."""
    return [math.radians(number) for number in parse_numbers(text, name, 3)]


def parse_direction(text: str, name: str) -> list[float]:
    """Return the unit vector (3) along a direction of any length, such as one that was rounded to two digits."""
    direction = parse_numbers(text, name, 3)
    length = math.hypot(*direction)
    if not length:
        raise InputError(f"{name} takes a direction, not zeros", got=text)
    return [component / length for component in direction]


DIRECTION, BODY_RATE = Parsed(parse_direction, "X,Y,Z"), Parsed(parse_rate, "X,Y,Z")


def parse_effort(text: str, name: str) -> float:
    """Return the computing budget: a positive number, or infinity for the text "inf"."""
    budget = math.inf if text == "inf" else plain_number(text)
    if not budget > 0:
        what, do = f"{name} must be a positive number or inf", "1 is the usual effort"
        raise InputError(what, got=text, do=do)
    return budget


def parse_grid(text: str, name: str) -> np.ndarray:
    """Return the values of one axis of a grid in rad/s, from low:high:step or comma-separated values in deg/s.

    With a step, the last value is the one nearest to `high`.
    """
    import numpy as np

    from sunspin.estimate.scan.volume import check_size

    if ":" not in text:
        return np.radians(parse_numbers(text, name))
    parts = text.split(":")
    # a step of zero, which is refused below, stands for a wrong number of parts
    low, high, step = parse_numbers(",".join(parts), name, 3) if len(parts) == 3 else (0, 0, 0)
    count = (high - low) / step + 1 if step > 0 and high >= low else math.nan
    if not math.isfinite(count):
        what = f"{name} must be low:high:step in deg/s, low to high and with a positive step"
        raise InputError(what, got=text, do=f"for example {name}=-6:6:1")
    if count > MAX_GRID:
        check_size(count, 1, 1)  # its error comes first: not even this axis alone fits in memory
        what = f"{name} has {count:.3g} values, more than {MAX_GRID}"
        raise InputError(what, got=text, do="use a larger step")
    steps = round((high - low) / step)
    return np.radians(np.linspace(low, low + step * steps, steps + 1))


def parse_vertical(text: str, name: str) -> Any:
    """Return the ground normal of `sunspin outcomes`: "legs_down", "any", an angle (rad) from upright, or a direction (3)."""
    if text in ("legs_down", "any"):
        return text
    values = parse_numbers(text, name)
    if len(values) not in (1, 3):
        raise InputError(f"{name} takes legs_down, any, an angle in degrees or x,y,z", got=text)
    return math.radians(values[0]) if len(values) == 1 else tuple(values)


def parse_prior(text: str, name: str) -> tuple[str, float]:
    """Return key and sigma of a text KEY=SIGMA; errors name the option together with the key."""
    key, _, sigma = text.partition("=")
    key = key.strip()
    return key, parse_numbers(sigma, f"{name} {key}", 1, separator="=")[0]


def parse_observation(text: str, name: str) -> dict[str, Any]:
    """Return an observation for `posterior`, with the time in s from the epoch.

    The name of the option determines the form of the text: T,VALUE,SIGMA of an angular speed (--rate-deg-s), T,X,Y,Z,SIGMA of a
    body rate (--gyro-deg-s), T,X,Y,Z,ANGLE,SIGMA of a magnetic direction (--field). Rates are in deg/s in the text and in rad/s in
    the result; angles are in rad in both.
    """
    kind = name.removeprefix("--").removesuffix("-deg-s")
    if kind == "field":
        t_s, x, y, z, angle_rad, sigma_rad = parse_numbers(text, name, 6)
        value = [x, y, z]
        return {
            "kind": kind,
            "t_s": t_s,
            "value": value,
            "angle_rad": angle_rad,
            "sigma": sigma_rad,
        }
    t_s, *rate_deg_s, sigma_deg_s = parse_numbers(text, name, {"rate": 3, "gyro": 5}[kind])
    rate = [math.radians(component) for component in rate_deg_s]
    return {"kind": kind, "t_s": t_s, "value": rate, "sigma": math.radians(sigma_deg_s)}


def parse_period(text: str, epoch_utc: str | None) -> Any:
    """Return the observed period (`Period`) of a text SECONDS+-SIGMA@TIME."""
    from sunspin.estimate.periods import Period

    value, _, rest = text.partition("+-")
    sigma, _, when = rest.partition("@")
    if not (value and sigma and when):
        what, do = "--period takes SECONDS+-SIGMA@TIME", "for example --period 13.0+-0.5@15:50"
        raise InputError(what, got=text, do=do)
    t_s, _ = parse_instant(when, epoch_utc, "--period")
    return Period(t_s, *parse_numbers(f"{value},{sigma}", "--period", 2))


def parse_instant(text: str, epoch_utc: str | None, option: str) -> tuple[float, str]:
    """Return a time in s from the epoch, and as text with its scale.

    The text is a number of seconds, a UTC date and time, or a time of the day of the epoch such as 16:20.
    """
    from sunspin.vehicle.timeline import utc_seconds

    text = text.strip()
    if ":" not in text and "T" not in text:
        return parse_numbers(text, option, 1, WHEN)[0], f"{text} s"
    if epoch_utc is None:
        raise InputError("the telemetry has no epoch, so a time must be in s", got=text)
    utc = text if "T" in text else f"{epoch_utc[:10]}T{text}"
    return utc_seconds(utc, epoch_utc), f"{utc.rstrip('Z')} UTC"


def parse_times(text: str, epoch_utc: str | None) -> dict[float, str]:
    """Return the times of --predict, sorted: s from the epoch -> text."""
    return dict(sorted(parse_instant(piece, epoch_utc, "--predict") for piece in text.split(",")))


def parse_limits(
    samples: Any, begin: str | None, end: str | None
) -> tuple[float | None, float | None]:
    """Return the times of --from and --to in s from the epoch; None for one that is not given."""
    epoch = samples.attrs.get("epoch_utc")
    first = None if begin is None else parse_instant(begin, epoch, "--from")[0]
    return first, None if end is None else parse_instant(end, epoch, "--to")[0]


def select_interval(samples: Any, begin: str | None, end: str | None) -> Any:
    """Return the samples from the time of --from to that of --to.

    Raises
    ------
    InputError
        A time cannot be read, or no sample lies in the interval.
    """
    from sunspin.vehicle.timeline import utc_after

    first, last = parse_limits(samples, begin, end)
    t = samples["time"].values
    inside = (t >= (-math.inf if first is None else first)) & (
        t <= (math.inf if last is None else last)
    )
    if not inside.any():
        span = " to ".join(utc_after(float(t_s), samples.attrs["epoch_utc"]) for t_s in t[[0, -1]])
        got = f"{begin or 'the beginning'} to {end or 'the end'}"
        what, do = "no samples lie between --from and --to", f"the file has {span}"
        raise InputError(what, got=got, do=do)
    return samples.isel(time=inside.nonzero()[0])
