"""Values of a vehicle file replaced in its text, comments and order kept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from sunspin.base.errors import VehicleError

REPLACES = {"relative_gain": ("cells",)}
"""A key that takes the place of others: a number of cells is not a gain."""


class NewValue(NamedTuple):
    """A value with its birth certificate, and `where` it goes: the table, and the name of its part where there are several."""

    where: Sequence[str]
    key: str
    value: Any
    sigma: Any
    source: str


def rewrite_values(text: str, values: Sequence[NewValue]) -> str:
    """The text of a valid vehicle file with these values in place of its own, or added to their tables.

    Raises
    ------
    VehicleError
        Where the file has no such table.
    """
    import tomlkit

    document = tomlkit.parse(text)
    for new in values:
        table: Any = document.get(new.where[0])
        for name in new.where[1:]:
            table = next((each for each in table or () if each.get("name") == name), None)
        if table is None:
            what = f"the vehicle file has no table [{'.'.join(new.where)}]"
            raise VehicleError(what, do="give the file of this vehicle")
        certificate = tomlkit.inline_table()
        certificate.update({"value": new.value, "sigma": new.sigma, "source": new.source})
        old = next((key for key in (new.key, *REPLACES.get(new.key, ())) if key in table), None)
        if old is not None:
            was = table.value.item(old).trivia
            certificate.trivia.comment_ws, certificate.trivia.comment = was.comment_ws, was.comment
        if old == new.key:
            table[new.key] = certificate
            continue
        # a new key follows the last one, before the comments that end the table; tomlkit has no public way to do that
        table.value._insert_after(old or list(table)[-1], new.key, certificate)
        if old is not None:
            table.remove(old)
    return tomlkit.dumps(document)
