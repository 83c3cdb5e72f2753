"""Values of a vehicle file replaced in its text, comments and order kept."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from sunspin.base.errors import VehicleError, sentence

OTHER_KEYS = {"relative_gain": ("cells",)}
"""A key that takes the place of others: a number of cells is not a gain."""


class NewValue(NamedTuple):
    """A value with its birth certificate, and `where` it goes: the table, and the name of its part where there are several."""

    where: Sequence[str]
    key: str
    value: Any
    sigma: Any
    source: str


def rewritten(text: str, values: Sequence[NewValue]) -> str:
    """The text of a valid vehicle file with these values in place of its own, or added to their tables.

    Raises
    ------
    VehicleError
        Where the file has no such table.
    """
    import tomlkit

    document = tomlkit.parse(text)
    for new in values:
        table = _table(document, new)
        certificate = tomlkit.inline_table()
        certificate.update({"value": new.value, "sigma": new.sigma, "source": new.source})
        _put(table, new.key, certificate)
    return tomlkit.dumps(document)


def _put(table: Any, key: str, certificate: Any) -> None:
    """A key's new value, with the comment of its line; a new key after the last one, before the comments that follow the table."""
    container = table.value
    old = next((one for one in (key, *OTHER_KEYS.get(key, ())) if one in table), None)
    if old is not None:
        trivia = container.item(old).trivia
        certificate.trivia.comment_ws, certificate.trivia.comment = (
            trivia.comment_ws,
            trivia.comment,
        )
    if old == key:
        table[key] = certificate
        return
    # tomlkit offers no public way to insert in the middle of a table
    container._insert_after(old or list(table)[-1], key, certificate)
    if old is not None:
        table.remove(old)


def _table(document: Any, new: NewValue) -> Any:
    name, *part = new.where
    found = document.get(name)
    if part and found is not None:
        found = next((one for one in found if one.get("name") == part[0]), None)
    if found is None:
        raise VehicleError(
            sentence(
                f"the vehicle file has no table [{'.'.join(new.where)}]",
                do="give the file of this vehicle",
            )
        )
    return found
