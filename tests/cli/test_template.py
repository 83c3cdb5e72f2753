"""The files that `sunspin init` writes are the complete example of their form."""

import re
import types
import typing
from importlib import resources

import pytest
from pydantic import BaseModel

from sunspin.vehicle_file import VehicleForm, parse_vehicle

TEXT = resources.files("sunspin").joinpath("template", "vehicle.toml").read_text("utf-8")


def keys(form: type[BaseModel]):
    """All keys that the form of a vehicle file knows, nested ones too."""
    for name, field in form.model_fields.items():
        yield name
        waiting = [field.annotation]
        while waiting:
            kind = waiting.pop()
            if isinstance(kind, type) and not isinstance(kind, types.GenericAlias) and issubclass(kind, BaseModel):
                yield from keys(kind)
            waiting += typing.get_args(kind)


@pytest.mark.parametrize("key", sorted(set(keys(VehicleForm))))
def test_every_key_is_in_the_template(key):
    assert re.search(rf"\b{key}\b", TEXT)


def test_what_is_commented_out_is_valid_too():
    """Lines such as `# lit_threshold = 0.06` are examples: they must parse when somebody takes the mark away."""
    opened = re.sub(r"^# (?=\[|[a-zA-Z_]+ = )", "", TEXT, flags=re.MULTILINE)
    assert opened.count("\n# ") < TEXT.count("\n# ")
    vehicle = parse_vehicle(opened, "template")
    assert len(vehicle.legs) == 1 and len(vehicle.sun_rules) == 1
    assert vehicle.telemetry.lit_threshold is not None and vehicle.telemetry.epoch_utc is not None
    assert set(vehicle.wheels[0].alternative_frictions) == {"cold"}


def test_the_spin_down_example_is_valid():
    spin_down = "".join(f"{line}\n" for line in re.findall(r"^#   (\[wheel\.friction.*|c\d_.*)$", TEXT, re.MULTILINE))
    body = re.sub(r"\[wheel\.friction\]\n.*\n.*\n", lambda _: spin_down, TEXT)
    friction = parse_vehicle(body, "template").wheels[0].friction
    assert friction.coulomb_N_m == pytest.approx(4.643e-4 * 388.9 * 3.0e-5)


def test_the_example_shows_a_birth_certificate():
    facts = parse_vehicle(TEXT, "template").facts
    assert any(fact.sigma is not None and fact.source for fact in facts.values())
