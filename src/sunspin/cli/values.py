"""Text of options into values; what is no such value is one sentence that names the option."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from sunspin.base.errors import InputError
from sunspin.base.untrusted import SIZES, is_sensible, plain_number

if TYPE_CHECKING:
    import numpy as np

MAX_GRID = 100_000
"""Values of one axis of a scan's grid."""

EXAMPLE = ("0.1", "0", "-0.2", "1", "0.5", "0.02")
"""Numbers of an option, as many as it takes."""

WHEN = "s from the epoch, or UTC such as 2014-11-12T16:20"


class Parsed(click.ParamType):
    """What `read` makes of the text and the name of an option; `form`: how --help writes the text."""

    def __init__(self, read: Callable[[str, str], Any], form: str = "text") -> None:
        self.read, self.name = read, form

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return self.read(value, param.opts[0] if param else "the option")


def check_text(text: Any, parameter: click.Parameter, context: click.Context) -> None:
    """Refuse, of what is given to an option or argument, empty text, which as a path would be the present folder, forms of numbers
    that only Python knows, and numbers that are infinite, none, or beyond all measure."""
    if not isinstance(text, str):  # not given, or a flag
        return
    if not text.strip():
        raise click.BadParameter("the value is empty", context, parameter)
    kind = parameter.type
    is_float = isinstance(kind, click.types.FloatParamType)
    if is_float or isinstance(kind, click.types.IntParamType):
        number = plain_number(text)
        if math.isnan(number):
            raise click.BadParameter(f"{text!r} is not a valid {kind.name}.", context, parameter)
        if is_float:
            above_0 = isinstance(kind, click.FloatRange) and kind.min == 0
            sizes = SIZES.removeprefix("0 or ") if above_0 else SIZES
            _check_number(parameter.opts[0], number, sizes)


def _check_number(name: str, value: float, sizes: str = SIZES) -> None:
    if not is_sensible(value):
        raise InputError(f"{name} must be {sizes}", got=str(value))


def numbers(text: str, name: str, count: int | None = None, form: str = "") -> list[float]:
    """Comma-separated numbers of an option; `form`: what it takes, where that is not only numbers."""
    values = [plain_number(part) for part in text.split(",")] if text else []
    if any(map(math.isnan, values)) or count not in (None, len(values)):
        several = f"{count or ''} numbers separated by commas".lstrip()
        what = f"{name} takes {form or ('a number' if count == 1 else several)}"
        sign = "=" if name.startswith("--prior ") else " "
        do = None if form else f"for example {name}{sign}{','.join(EXAMPLE[: count or 3])}"
        raise InputError(what, got=text or "nothing", do=do)
    for value in values:
        _check_number(name, value)
    return values


def rate(text: str, name: str) -> list[float]:
    """A body rate in deg/s; the result is in rad/s."""
    return [math.radians(each) for each in numbers(text, name, 3)]


VECTOR, BODY_RATE = Parsed(partial(numbers, count=3), "X,Y,Z"), Parsed(rate, "X,Y,Z")


def effort(text: str, name: str) -> float:
    """A positive number, or infinity."""
    given = math.inf if text == "inf" else plain_number(text)
    if not given > 0:
        what, do = f"{name} must be a positive number or inf", "1 is the usual effort"
        raise InputError(what, got=text, do=do)
    return given


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


def vertical(text: str, name: str) -> Any:
    """The name of a rule, rad about legs-down, or a direction."""
    if text in ("legs_down", "any"):
        return text
    values = numbers(text, name)
    if len(values) not in (1, 3):
        raise InputError(f"{name} takes legs_down, any, an angle in degrees or x,y,z", got=text)
    return math.radians(values[0]) if len(values) == 1 else tuple(values)


def prior(text: str, name: str) -> tuple[str, float]:
    """KEY=SIGMA."""
    key, _, value = text.partition("=")
    return key.strip(), numbers(value, f"{name} {key.strip()}", 1)[0]


def observation(text: str, name: str) -> dict[str, Any]:
    """What an option of this name takes: T,VALUE,SIGMA of an angular speed or T,X,Y,Z,SIGMA of a body rate, in deg/s (the result is
    in rad/s); T,X,Y,Z,ANGLE,SIGMA of a magnetic direction."""
    kind = name.removeprefix("--").removesuffix("-deg-s")
    t, *value, sigma = numbers(text, name, {"rate": 3, "gyro": 5, "field": 6}[kind])
    if kind == "field":
        *value, angle = value
        return {"kind": kind, "t_s": t, "value": value, "angle_rad": angle, "sigma": sigma}
    value = [math.radians(each) for each in value]
    return {"kind": kind, "t_s": t, "value": value, "sigma": math.radians(sigma)}


def period(text: str, epoch_utc: str | None) -> Any:
    """SECONDS+-SIGMA@TIME of a period seen."""
    from sunspin.estimate.terms.period import Period

    value, _, rest = text.partition("+-")
    sigma, _, when = rest.partition("@")
    if not (value and sigma and when):
        what, do = "--period takes SECONDS+-SIGMA@TIME", "for example --period 13.0+-0.5@15:50"
        raise InputError(what, got=text, do=do)
    t_s, _ = instant(when, epoch_utc, "--period")
    return Period(t_s, *numbers(f"{value},{sigma}", "--period", 2))


def instant(text: str, epoch_utc: str | None, option: str) -> tuple[float, str]:
    """A time in s from the epoch and as text, given in s, as UTC or as the clock on the epoch's day."""
    from sunspin.vehicle.timeline import utc_seconds

    text = text.strip()
    if ":" not in text and "T" not in text:
        return numbers(text, option, 1, WHEN)[0], f"{text} s"
    if epoch_utc is None:
        raise InputError("the telemetry has no epoch, so a time must be in s", got=text)
    utc = text if "T" in text else f"{epoch_utc[:10]}T{text}"
    return utc_seconds(utc, epoch_utc), f"{utc.rstrip('Z')} UTC"


def times(text: str, epoch_utc: str | None) -> dict[float, str]:
    """The times of --predict: s from the epoch -> as text, in their order."""
    return dict(sorted(instant(piece, epoch_utc, "--predict") for piece in text.split(",")))


def instants_of(
    samples: Any, begin: str | None, end: str | None
) -> tuple[float | None, float | None]:
    """Seconds from the epoch of --from and --to; None where they are not given."""
    epoch = samples.attrs.get("epoch_utc")
    first = None if begin is None else instant(begin, epoch, "--from")[0]
    return first, None if end is None else instant(end, epoch, "--to")[0]


def between(samples: Any, begin: str | None, end: str | None) -> Any:
    """The samples from one time to another."""
    from sunspin.vehicle.timeline import utc_after

    first, last = instants_of(samples, begin, end)
    t = samples["time"].values
    after, before = -math.inf if first is None else first, math.inf if last is None else last
    inside = (t >= after) & (t <= before)
    if not inside.any():
        there = " to ".join(utc_after(float(at), samples.attrs["epoch_utc"]) for at in t[[0, -1]])
        got = f"{begin or 'the beginning'} to {end or 'the end'}"
        what, do = "no samples lie between --from and --to", f"the file has {there}"
        raise InputError(what, got=got, do=do)
    return samples.isel(time=inside.nonzero()[0])
