"""Text of numbers: all numbers of results become text here. Rates are shown in deg/s."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sunspin.output.folder import to_plain_data
from sunspin.vehicle.timeline import utc_after

ROUNDING = 1e-9
"""Sigma relative to its number below which it comes from rounding: all runs of a simulation gave one number."""

LONGEST = 400
"""Characters at which :func:`number_text` cuts a text."""


def number_text(value: Any, digits: int = 4) -> str:
    """Return a value of a summary as text, cut at `LONGEST` characters.

    Numbers have `digits` significant digits, lists are in parentheses, booleans are yes or no, None and numbers that are not finite
    are none, dicts are "key value; key value", lists of panel names are joined as in 2-3; 2-3-6.
    """
    value = to_plain_data(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:z.{digits}g}"
    if isinstance(value, dict):
        text = "; ".join(
            f"{key.replace('_', ' ')} {number_text(item, digits)}" for key, item in value.items()
        )
    elif isinstance(value, list) and value and all(map(_is_list_of_names, value)):
        text = "; ".join(map(set_text, value))
    elif isinstance(value, list):
        nested = any(isinstance(item, list | dict) for item in value)
        separator = "; " if nested else ", "
        text = "(" + separator.join(number_text(item, digits) for item in value) + ")"
    else:
        text = "none" if value is None else str(value)
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def set_text(names: Sequence[str]) -> str:
    """Return names of panels on one line: 2-3-6 as in the paper, or -X, +Y, -Z if a name has signs in it."""
    separator = "-" if all(name.isalnum() for name in names) else ", "
    return separator.join(names)


def size_text(value: float, digits: int = 3) -> str:
    """Return the size of an error with `digits` significant digits; from 0.0001 on without an exponent: 1080, 0.02."""
    if not np.isfinite(value) or 0 < abs(value) < 1e-4:
        return f"{value:.{digits}g}"
    return np.format_float_positional(value, precision=digits, fractional=False, trim="-")


def _is_list_of_names(value: Any) -> bool:
    """Return whether a value is a list of names, not empty."""
    return isinstance(value, list) and bool(value) and all(isinstance(name, str) for name in value)


def with_sigma(value: Any, sigma: Any, unit: str = "") -> str:
    """Return a number with its sigma to two digits: 1.234 ± 0.056 deg/s; numbers (n) stand in parentheses.

    Without a finite, positive sigma the number stands alone, and if sigma is only rounding.
    """
    unit = f" {unit}" if unit else ""
    if np.ndim(value):
        return f"({', '.join(map(with_sigma, value, sigma))}){unit}"
    if not (np.isfinite(sigma) and sigma > ROUNDING * abs(value)):
        return f"{number_text(float(value))}{unit}"
    if sigma < 1e-5:  # powers of ten, with digits of the value down to the second one of sigma
        digits = max(int(np.floor(np.log10(max(abs(value), sigma) / sigma))) + 2, 2)
        return f"{value:z.{digits}g} ± {sigma:.2g}{unit}"
    decimals = _decimals(sigma)
    return f"{value:z.{decimals}f} ± {sigma:.{decimals}f}{unit}"


def signed_text(value: float, sigma: float, unit: str) -> str:
    """Return a number with its sign and its sigma, as :func:`with_sigma`: +1.234 ± 0.056 deg/s."""
    text = with_sigma(value, sigma, unit)
    return text if text.startswith("-") else f"+{text}"


def with_range(value: float, low: float, high: float) -> str:
    """Return a number and the ends of its range, to two digits of half the range: 3.53 (3.49 to 3.57)."""
    decimals = _decimals((high - low) / 2)
    return f"{value:z.{decimals}f} ({range_text(low, high)})"


def range_text(low: float, high: float, sigma: float = 0.0) -> str:
    """Return the ends of a range, to two digits of half the range or of a larger `sigma`: 3.49 to 3.57."""
    decimals = _decimals(max((high - low) / 2, sigma))
    return f"{low:z.{decimals}f} to {high:z.{decimals}f}"


def _decimals(sigma: float) -> int:
    """Return the number of decimals (0 to 9) that shows an error with two digits; 3 if the error is not finite or not positive."""
    if not (np.isfinite(sigma) and sigma > 0):
        return 3
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9))


def rate_text(omega_rad_s: Any) -> str:
    """Return a body rate (3) or an angular speed, given in rad/s, as text in deg/s."""
    return f"{number_text(np.degrees(omega_rad_s))} deg/s"


def clock_text(data: Any, seconds: float) -> str:
    """Return a time (s from the epoch) of a result as UTC, or in s if the result has no epoch."""
    epoch = str(data.attrs.get("epoch_utc") or "")
    return utc_after(seconds, epoch) if epoch else f"{seconds:z.0f} s"


def start_texts(data: Any, seconds: Sequence[float]) -> list[str]:
    """Return start times (s from the epoch) for a table: month, day and minute in UTC, with the year if the years differ."""
    texts = [clock_text(data, second) for second in seconds]
    years = {text[:4] for text in texts}
    begin = len("2026-") if len(years) == 1 else 0
    # up to the minute; a time in s, of a result without epoch, has no "T" and stays
    return [text[begin:16].replace("T", " ") if "T" in text else text for text in texts]


def period_text(rate_rad_s: float) -> str:
    """Return the period of one revolution at a rate (rad/s, not zero), in seconds below two minutes, else in minutes."""
    seconds = 2 * np.pi / abs(rate_rad_s)
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def capitalize_first(text: str) -> str:
    """Return a text with a capital first letter, the rest unchanged."""
    return text[:1].upper() + text[1:]


def count_text(n: int, noun: str) -> str:
    """Return a number with its noun, as in 1 sample, 3 samples, 12 000 samples."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}".replace(",", " ")


def times_text(data: Any) -> list[str]:
    """Return the times of a result in UTC, to the millisecond; empty texts without an epoch."""
    epoch = str(data.attrs.get("epoch_utc") or "")
    return [utc_after(t, epoch, 3) if epoch else "" for t in data["time"].values.tolist()]
