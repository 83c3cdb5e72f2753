"""The result of `rates` on the template: variables, dimensions, kinds of numbers, units and attributes are those of a stored list.

Output and the paper's study read a result by this list.
"""

import json
from pathlib import Path

import sunspin as ss
from sunspin.output.template import write_templates
from tests.support.schemas import schema

STORED = json.loads(Path(__file__).with_name("schema_rates.json").read_text("utf-8"))


def test_result_of_rates_has_the_stored_schema(tmp_path):
    vehicle, telemetry = write_templates(tmp_path)
    craft = ss.load_vehicle(vehicle)
    assert schema(ss.rates(craft, ss.read_telemetry(telemetry, craft))) == STORED
