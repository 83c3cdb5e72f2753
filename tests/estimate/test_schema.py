"""The result of `rates` on the template: variables, dimensions, kinds of numbers, units and attributes are those of a stored list.

Output and the paper's study read a result by this list.
"""

import json
from pathlib import Path

import pytest

import sunspin as ss
from sunspin.output.template import write_templates

STORED = json.loads(Path(__file__).with_name("schema_rates.json").read_text("utf-8"))


def schema(result):
    """Return dimensions, kind and attributes of each variable, and the kind of each attribute of a result."""
    variables = {
        name: {
            "dims": list(part.dims),
            "kind": part.dtype.kind,
            "attrs": {key: str(value) for key, value in sorted(part.attrs.items())},
        }
        for name, part in sorted(result.variables.items())
    }
    kinds = {str: "text", int: "integer", float: "number"}
    attrs = {
        name: next(word for kind, word in kinds.items() if isinstance(value, kind))
        for name, value in sorted(result.attrs.items())
    }
    return {"variables": variables, "attrs": attrs}


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """Return vehicle and telemetry of the template."""
    vehicle, telemetry = write_templates(tmp_path_factory.mktemp("template"))
    craft = ss.load_vehicle(vehicle)
    return craft, ss.read_telemetry(telemetry, craft)


def test_result_of_rates_has_the_stored_schema(template):
    found = schema(ss.rates(*template))
    assert found["variables"] == STORED["variables"]
    assert found["attrs"] == STORED["attrs"]
