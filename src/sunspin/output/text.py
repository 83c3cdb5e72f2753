"""Numbers as a person reads them: the one place where results' numbers become text. Rates are shown in deg/s."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sunspin.output.folder import plain
from sunspin.vehicle.timeline import utc_after

LONGEST = 400
"""Characters of a value that :func:`number_text` returns."""


def number_text(value: Any, digits: int = 4) -> str:
    """A number with so many digits, lists in parentheses, sets of names as 2-3; 2-3-6, yes or no, anything else as it is."""
    value = plain(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:z.{digits}g}"
    if isinstance(value, dict):
        text = "; ".join(
            f"{key.replace('_', ' ')} {number_text(item, digits)}" for key, item in value.items()
        )
    elif isinstance(value, list) and value and all(map(_is_names, value)):
        text = "; ".join(map(set_text, value))
    elif isinstance(value, list):
        mark = "; " if any(isinstance(item, list | dict) for item in value) else ", "
        text = "(" + mark.join(number_text(item, digits) for item in value) + ")"
    else:
        text = "none" if value is None else str(value)
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def set_text(names: Sequence[str]) -> str:
    """Return a set of names on one line: 2-3-6 as in the paper, or -X, +Y, -Z if a name has more than letters and digits."""
    return ("-" if all(name.isalnum() for name in names) else ", ").join(names)


def size_text(value: float, digits: int = 3) -> str:
    """Return the size of an error with so many digits; without an exponent from 0.0001 on: 1080, 0.02."""
    if not np.isfinite(value) or 0 < abs(value) < 1e-4:
        return f"{value:.{digits}g}"
    return np.format_float_positional(value, precision=digits, fractional=False, trim="-")


def _is_names(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(name, str) for name in value)


def with_sigma(value: Any, sigma: Any, unit: str = "") -> str:
    """A number, or numbers (n) in parentheses, each with its sigma to two digits: 1.234 ± 0.056 deg/s."""
    unit = f" {unit}" if unit else ""
    if np.ndim(value):
        return f"({', '.join(map(with_sigma, value, sigma))}){unit}"
    if not (np.isfinite(sigma) and sigma > 0):
        return f"{number_text(float(value))}{unit}"
    if sigma < 1e-5:
        digits = max(int(np.floor(np.log10(max(abs(value), sigma) / sigma))) + 2, 2)
        return f"{value:z.{digits}g} ± {sigma:.2g}{unit}"
    decimals = _decimals(sigma)
    return f"{value:z.{decimals}f} ± {sigma:.{decimals}f}{unit}"


def with_range(value: float, low: float, high: float) -> str:
    """A number and the ends of its range, to two digits of half the range: 3.53 (3.49 to 3.57)."""
    half = (high - low) / 2
    decimals = _decimals(half) if np.isfinite(half) and half > 0 else 3
    return f"{value:z.{decimals}f} ({range_text(low, high)})"


def range_text(low: float, high: float, sigma: float = 0.0) -> str:
    """Return the ends of a range, to two digits of half the range or of a larger `sigma`: 3.49 to 3.57."""
    half = max((high - low) / 2, sigma)
    decimals = _decimals(half) if np.isfinite(half) and half > 0 else 3
    return f"{low:z.{decimals}f} to {high:z.{decimals}f}"


def _decimals(sigma: float) -> int:
    """Decimals that show an error with two digits."""
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9))


def rate_text(omega_rad_s: Any) -> str:
    """A body rate (rad/s) in deg/s."""
    return f"{number_text(np.degrees(omega_rad_s))} deg/s"


def clock_text(data: Any, seconds: float) -> str:
    """A time (s) of a result: UTC, or s if its epoch is not known."""
    epoch = str(data.attrs.get("epoch_utc") or "")
    return utc_after(seconds, epoch) if epoch else f"{seconds:z.0f} s"


def starts_text(data: Any, seconds: Sequence[float]) -> list[str]:
    """Return times (s) of a result as a table shows them: month, day and minute in UTC, with the year if they do not share it."""
    texts = [clock_text(data, each) for each in seconds]
    begin = 5 if len({text[:4] for text in texts}) == 1 else 0
    return [text[begin:16].replace("T", " ") if "T" in text else text for text in texts]


def turn_text(rate_rad_s: float) -> str:
    """The time of one revolution: seconds below two minutes, else minutes."""
    seconds = 2 * np.pi / abs(rate_rad_s)
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def capital(text: str) -> str:
    """A text that begins as a sentence does."""
    return text[:1].upper() + text[1:]


def counted(n: int, noun: str) -> str:
    """3 samples, 1 sample."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}".replace(",", " ")
