"""Replacement of values in the text of a vehicle file; comments and order are kept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from sunspin.base.errors import VehicleError

REPLACES = {"relative_gain": ("cells",)}
"""Keys that a new key replaces: a calibrated gain replaces a number of cells."""


class NewValue(NamedTuple):
    """A value with its sigma and source; `where`: the table, and the name of the part if there are several."""

    where: Sequence[str]
    key: str
    value: Any
    sigma: Any
    source: str


def rewrite_values(text: str, values: Sequence[NewValue]) -> str:
    """Return the text of a valid vehicle file in which the given values replace its own, or are added to their tables.

    Raises
    ------
    VehicleError
        If the file has no such table.
    """
    import tomlkit

    document = tomlkit.parse(text)
    for new in values:
        table: Any = document.get(new.where[0])
        for name in new.where[1:]:  # the table is a list of parts, of which this one is chosen
            table = next((each for each in table or () if each.get("name") == name), None)
        if table is None:
            what = f"the vehicle file has no table [{'.'.join(new.where)}]"
            raise VehicleError(what, do="give the file of this vehicle")
        value_table = tomlkit.inline_table()
        value_table.update({"value": new.value, "sigma": new.sigma, "source": new.source})
        old_key = next((key for key in (new.key, *REPLACES.get(new.key, ())) if key in table), None)
        if old_key is not None:
            old_trivia = table.value.item(old_key).trivia  # whitespace and comment after the value
            value_table.trivia.comment_ws = old_trivia.comment_ws
            value_table.trivia.comment = old_trivia.comment
        if old_key == new.key:
            table[new.key] = value_table
            continue
        # a new key is inserted after the last one, before comments at the end of the table; tomlkit offers no public method
        table.value._insert_after(old_key or list(table)[-1], new.key, value_table)
        if old_key is not None:
            table.remove(old_key)
    return tomlkit.dumps(document)
