"""Packages that are not installed by default: which optional dependency (extra) brings them, and whether they are there."""

from __future__ import annotations

from importlib.util import find_spec

from sunspin.base.errors import InputError

PICTURES = ("matplotlib", "plotly", "jinja2")
"""Packages that draw figures and write the HTML page."""

EXTRAS = {"pictures": PICTURES, "study": PICTURES}
"""Extra of pyproject.toml -> the modules that it brings. The study needs no others than its figures and its page."""


def missing_packages(extra: str) -> list[str]:
    """Return the modules of an extra that are not installed; none of them is imported."""
    return [name for name in EXTRAS[extra] if find_spec(name) is None]


def install_command(extra: str) -> str:
    """Return the command that installs an extra."""
    return f'pip install "sunspin[{extra}]"'


def require_extra(extra: str, purpose: str) -> None:
    """Raise `InputError` if a package of an extra is not installed; `purpose` is what needs it, the subject of the message."""
    if missing := missing_packages(extra):
        names = " and ".join(filter(None, [", ".join(missing[:-1]), missing[-1]]))
        verb = "are" if len(missing) > 1 else "is"
        what = f"{purpose} needs {names}, which {verb} not installed"
        raise InputError(what, do=f"install sunspin[{extra}]: {install_command(extra)}")
