"""Assumptions of the study of a landing that are not properties of the vehicle: rules for the data, and the effect of a collision.

The values of the paper, each with its source, are in ``cases/philae/assumptions.toml``; they hold for any lander unless
changed.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from sunspin.base.errors import InputError, VehicleError
from sunspin.base.untrusted import read_toml
from sunspin.vehicle.changes import Change, Changes, apply_changes, bare_value, parse_changes
from sunspin.vehicle.part import Number, Part, describe_error, keys_of, must, part

WHERE = "the study's assumptions"
"""Name of the assumptions in messages."""

Share = Annotated[
    Number, must(lambda share: 0 <= share <= 1, "{path} must be a share between 0 and 1")
]


@part
class StudyRules(Part):
    """Rules of the reconstruction.

    `lead_s`: time (s) from the first touchdown to the first sample; None: as given by the times of the telemetry.
    `target_weights`: measured directions count equally, or in proportion to the time they represent (half the gaps to their
    neighbours). `mask`: simulated directions count only if the panels would determine them, or everywhere.
    `near_minimum_factor`: the paper's near-minimum set has an EMD below this factor times the smallest. `confidence`: of the
    calibrated set.
    """

    lead_s: (
        Annotated[Number, must(lambda lead: lead >= 0, "{path} must be zero or a positive time")]
        | None
    ) = None
    target_weights: Annotated[Literal["equal", "interval"], BeforeValidator(bare_value)] = "equal"
    mask: Annotated[Literal["reconstructible", "everywhere"], BeforeValidator(bare_value)] = (
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
    """Effect of an impact on a leg, see :func:`sunspin.impact`: coefficient of restitution, and share of the damper."""

    restitution: Share = 0.0
    damper: Share = 0.0


@part
class AssumptionsFile(Part):
    """Tables of the assumptions file."""

    study: StudyRules = StudyRules()
    collision: Collision = Collision()


@part
class Assumptions(AssumptionsFile):
    """All assumptions, and the `changes` made to them for this run."""

    changes: tuple[Any, ...] = ()


TABLES = tuple(keys_of(AssumptionsFile))
"""Names of the tables, by which changes of assumptions are recognised."""


def assumptions_table() -> dict[str, Any]:
    """Read the parsed TOML of the assumptions file."""
    path = resources.files("sunspin").joinpath("cases", "philae", "assumptions.toml")
    return read_toml(path.read_text(encoding="utf-8"), WHERE, InputError)


def read_assumptions(changes: Changes = None) -> Assumptions:
    """Read the paper's assumptions and apply changes; raise `InputError` for a change that is not valid or out of range."""
    table = assumptions_table()
    settings = apply_changes(table, parse_changes(changes))
    try:
        file = TypeAdapter(AssumptionsFile).validate_python(
            table, context="file", by_alias=True, by_name=False
        )
    except ValidationError as error:
        raise InputError(describe_error(error, AssumptionsFile, WHERE, table)) from None
    except VehicleError as error:
        raise InputError(f"{WHERE}: {error}") from None
    return Assumptions(file.study, file.collision, settings)


def split_changes(changes: Changes) -> tuple[tuple[Change, ...], tuple[Change, ...]]:
    """Return the changes of the vehicle, and those of the assumptions, recognised by the table with which their key begins."""
    all_changes = parse_changes(changes)
    study_changes = tuple(
        change for change in all_changes if re.split(r"[.\[]", change.key)[0] in TABLES
    )
    return tuple(change for change in all_changes if change not in study_changes), study_changes
