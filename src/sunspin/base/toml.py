"""Reading TOML that somebody may have damaged: one sentence, whatever Python's reader does."""

from __future__ import annotations

import tomllib
from typing import Any

from sunspin.base.errors import SunspinError

MAX_DOTS = 1000
"""In one line: Python's reader of TOML takes a time that grows with the square of the parts of a dotted key."""


def read_toml(
    text: str, where: str, error_type: type[SunspinError], do: str = "correct that line"
) -> dict[str, Any]:
    """The table of a TOML text; `where` names the file in messages, `do` says what to do where it is no TOML."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.count(".") > MAX_DOTS:
            what = f"the line has more than {MAX_DOTS} decimal points or dots"
            place = f"{where}, line {number}"
            raise error_type(what, do="write it as several lines", where=place)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise error_type(f"this is not valid TOML: {error}", do=do, where=where) from None
    except RecursionError:
        what = "the file is nested too deeply"
        raise error_type(what, do="give the right file", where=where) from None
    except ValueError as error:  # tomllib hands on what int() says of thousands of digits
        what = f"this is not valid TOML: {error}"
        raise error_type(what, do="correct that number", where=where) from None
