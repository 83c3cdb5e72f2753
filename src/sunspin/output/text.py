"""Numbers as a person reads them."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.output.folder import plain


def number_text(value: Any, digits: int = 5) -> str:
    """A number with so many digits, lists in parentheses, sets of names as 2-3; 2-3-6, yes or no, anything else as it is."""
    value = plain(value)
    if isinstance(value, list):
        if value and all(
            isinstance(one, list) and one and all(isinstance(name, str) for name in one)
            for one in value
        ):
            return "; ".join("-".join(names) for names in value)
        mark = "; " if any(isinstance(item, list | dict) for item in value) else ", "
        return "(" + mark.join(number_text(item, digits) for item in value) + ")"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return "; ".join(
            f"{key.replace('_', ' ')} {number_text(item, digits)}" for key, item in value.items()
        )
    if isinstance(value, float):
        return f"{value:z.{digits}g}" if np.isfinite(value) else "none"
    return "none" if value is None else str(value)


def digits_of(sigmas: Any) -> int:
    """Decimals that show the smallest of these errors with one figure, two to five."""
    values = np.asarray(sigmas, dtype=np.float64)
    known = values[np.isfinite(values) & (values > 0)]
    return int(np.clip(-np.floor(np.log10(known.min())), 2, 5)) if len(known) else 2


def rate_text(omega_rad_s: Any) -> str:
    """A body rate as options and files have it, and in deg/s."""
    return f"{number_text(omega_rad_s)} rad/s, which is {number_text(np.degrees(omega_rad_s), 4)} deg/s"


def with_sigma(value: float, sigma: float) -> str:
    """A number and its sigma, both with as many decimals as show two figures of the sigma."""
    if not (np.isfinite(sigma) and sigma > 0):
        return f"{value:.3f} ± {sigma:.3g}"
    decimals = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9))
    return f"{value:z.{decimals}f} ± {sigma:.{decimals}f}"


def turn_text(rate_rad_s: float) -> str:
    """The time of one turn: seconds below two minutes, else minutes."""
    seconds = 2 * np.pi / abs(rate_rad_s)
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def size_text(size: int) -> str:
    """The size of a file of so many bytes, in MB or where it is small in kB."""
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{max(size / 1e3, 0.1):.1f} kB"


def capital(text: str) -> str:
    """A text that begins as a sentence does."""
    return text[:1].upper() + text[1:]


def counted(n: int, noun: str) -> str:
    """3 samples, 1 sample."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}".replace(",", " ")
