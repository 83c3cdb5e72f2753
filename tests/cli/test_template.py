"""The files that `sunspin init` writes: a complete and valid example."""

import re
from importlib import resources
from itertools import takewhile

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle.file import VehicleFile, parse_vehicle
from sunspin.vehicle.part import Part, keys_of, part_in
from sunspin.vehicle.parts import Fact

TEXT = resources.files("sunspin").joinpath("template", "vehicle.toml").read_text("utf-8")


def keys(kind: type[Part]):
    """All keys that a vehicle file may have, those of its tables too."""
    for key, annotation in keys_of(kind).items():
        yield key
        if inner := part_in(annotation):
            yield from keys(inner)


def test_every_key_is_in_the_template():
    assert [key for key in set(keys(VehicleFile)) if not re.search(rf"\b{key}\b", TEXT)] == []


def test_commented_examples_of_the_template_are_valid():
    """Lines such as `# lit_threshold = 0.06` are examples: they must parse when somebody takes the mark away."""
    opened = re.sub(r"^# (?=\[|[a-zA-Z_]+ = )", "", TEXT, flags=re.MULTILINE)
    assert opened.count("\n# ") < TEXT.count("\n# ")
    vehicle = parse_vehicle(opened, "template")
    assert len(vehicle.legs) == 1 and len(vehicle.sun_rules) == 1
    assert vehicle.telemetry.lit_threshold is not None and vehicle.telemetry.epoch_utc is not None
    assert set(vehicle.wheels[0].alternative_frictions) == {"cold"}
    assert any(fact.sigma is not None and fact.source for fact in vehicle.facts.values())


def test_the_examples_of_a_spin_down_and_of_a_tilted_panel_in_the_template_are_valid():
    lines = re.findall(r"^#   (\[wheel\.friction.*|c\d_.*)$", TEXT, re.MULTILINE)
    spin_down = "\n".join([*lines, ""])
    body = re.sub(r"\[wheel\.friction\]\n.*\n.*\n", lambda _: spin_down, TEXT)
    friction = parse_vehicle(body, "template").wheels[0].friction
    assert friction.coulomb_N_m == pytest.approx(4.643e-4 * 388.9 * 3.0e-5)
    first, *others = TEXT[TEXT.index("#   [panel_response.tilted]") :].splitlines()
    values = takewhile(lambda line: line.startswith("#   ") and "[" not in line[:5], others)
    opened = "\n".join([TEXT, *(line.removeprefix("#   ") for line in (first, *values))])
    given = parse_vehicle(opened, "template")
    assert given.response_in() != parse_vehicle(TEXT, "template").response_in()


def test_the_telemetry_of_the_template_is_simulated_from_its_stated_truth():
    """The made-up telemetry is the vehicle beside it, moving as the truth that the documentation names."""
    folder = resources.files("sunspin").joinpath("template")
    vehicle = parse_vehicle(TEXT, "template")
    read = ss.read_telemetry(folder.joinpath("telemetry.csv"), vehicle)
    truth = {"omega_B": [0.02, -0.03, 0.05], "sun_B": [0.5, 0.4, 0.768], "scale": 0.775}
    made = ss.twin(vehicle, truth | {"t_s": read.time.values}, seed=1)
    assert np.abs(read.power_W.values - made.power_W.values).max() <= 0.000501


@pytest.mark.parametrize("sigma", [-0.1, np.nan, (0.1, -0.1, 0.1)])
def test_a_fact_in_python_has_no_negative_sigma(sigma):
    with pytest.raises(ss.VehicleError, match="sigma of a value must be finite and not negative"):
        Fact(7.0, sigma)
    assert Fact(7.0, 0.0).sigma == 0.0 and Fact(7.0).sigma is None
