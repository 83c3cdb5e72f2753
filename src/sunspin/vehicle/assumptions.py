"""What the study of a landing assumes beside its vehicle: its rules for the data, and what a collision does.

The values of the paper, each with its source, stand in ``cases/philae/assumptions.toml``; they hold for any lander unless changed.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from sunspin.base.errors import InputError, VehicleError
from sunspin.base.untrusted import read_toml
from sunspin.vehicle import changes as ch
from sunspin.vehicle.part import Number, Part, describe_error, keys_of, must, part

WHERE = "the study's assumptions"

Share = Annotated[
    Number, must(lambda share: 0 <= share <= 1, "{path} must be a share between 0 and 1")
]


@part
class Study(Part):
    """Rules of the reconstruction.

    `lead_s`: from the first touchdown to the first sample; None: as the times of the telemetry say. `target_weights`: every
    measured direction counts the same, or for the time that it stands for (half the gaps to its neighbours). `mask`: simulated
    directions count where the panels would allow to reconstruct them, or everywhere. `near_minimum_factor`: the paper's set lies
    below so many times the smallest EMD. `confidence`: of the calibrated set.
    """

    lead_s: (
        Annotated[Number, must(lambda lead: lead >= 0, "{path} must be zero or a positive time")]
        | None
    ) = None
    target_weights: Annotated[Literal["equal", "interval"], BeforeValidator(ch.bare_value)] = (
        "equal"
    )
    mask: Annotated[Literal["reconstructible", "everywhere"], BeforeValidator(ch.bare_value)] = (
        "reconstructible"
    )
    near_minimum_factor: Annotated[
        Number, must(lambda factor: factor > 1, "{path} must exceed 1")
    ] = 1.1
    confidence: Annotated[
        Number, must(lambda share: 0 < share < 1, "{path} must lie between 0 and 1")
    ] = 0.9


@part
class Collision(Part):
    """What a blow on a leg does: see :func:`sunspin.impact`."""

    restitution: Share = 0.0
    damper: Share = 0.0


@part
class AssumptionsFile(Part):
    """The tables of the file."""

    study: Study = Study()
    collision: Collision = Collision()


@part
class Assumptions(AssumptionsFile):
    """All of these; `changes`: what was set for this run."""

    changes: tuple[Any, ...] = ()


TABLES = tuple(keys_of(AssumptionsFile))


def assumptions_table() -> dict[str, Any]:
    """The parsed TOML of the assumptions."""
    path = resources.files("sunspin").joinpath("cases", "philae", "assumptions.toml")
    return read_toml(path.read_text(encoding="utf-8"), WHERE, InputError)


def read_assumptions(changes: ch.Changes = None) -> Assumptions:
    """The paper's assumptions with changes; `InputError` for one that is none or out of its range."""
    table = assumptions_table()
    done = ch.apply_changes(table, ch.parse_changes(changes))
    try:
        file = TypeAdapter(AssumptionsFile).validate_python(
            table, context="file", by_alias=True, by_name=False
        )
    except ValidationError as error:
        raise InputError(describe_error(error, AssumptionsFile, WHERE, table)) from None
    except VehicleError as error:
        raise InputError(f"{WHERE}: {error}") from None
    return Assumptions(file.study, file.collision, done)


def split_changes(changes: ch.Changes) -> tuple[tuple[ch.Change, ...], tuple[ch.Change, ...]]:
    """Changes of the vehicle, and those of the assumptions."""
    asked = ch.parse_changes(changes)
    mine = tuple(each for each in asked if re.split(r"[.\[]", each.key)[0] in TABLES)
    return tuple(each for each in asked if each not in mine), mine
