"""Twins for `rates` whose samples are far apart: between two of them the body may turn any number of times.

    PYTHONPATH=. python tests/sparse_twins.py OUT --seed 11 --twins 40

Those of `tests/orbit_rates_twins.py`, a sample every 20 to 60 s, without an orbit and without a largest rate: with panels and a
magnetometer, and with panels alone. Twins with odd numbers turn at 2.5 to 16 deg/s, the others at 0.3 to 4. All of it is synthetic.
"""

from __future__ import annotations

import sys
from typing import Any

import sunspin as ss
from orbit_rates_twins import judged, make, one_pass, table
from strange_rates import campaign
from sunspin.base.errors import SunspinError
from sunspin.compute.campaign import command

EVERY_S, SLOW, FAST = (20.0, 60.0), (-0.5, 0.6), (0.4, 1.2)
SENSORS: dict[str, list[str]] = {"with a magnetometer": [], "panels alone": ["field_B"]}
"""What is seen, and what of the telemetry is left out for it."""


def judge(seed: int, i: int) -> dict[str, Any]:
    """What `rates` says of the passes of a file."""
    vehicle, data, _, truth, about = make(seed, i, 2000, EVERY_S, FAST if i % 2 else SLOW)
    for name, dropped in SENSORS.items():
        about[name] = []
        for begin in about["begin_s"]:
            try:
                about[name].append(
                    judged(ss.rates(vehicle, one_pass(data, begin).drop_vars(dropped)), truth, 0)
                )
            except SunspinError as error:
                about[name].append({"refused": str(error)})
    return about


@command
def main(arguments: list[str] | None = None) -> None:
    """Run twins and print what becomes of them, and a table."""
    rows = dict(campaign("tests/sparse_twins.py", "sparse", judge, arguments))
    for name in SENSORS:
        for what, odd in (("slow", 0), ("fast", 1)):
            if some := [one for i, row in rows.items() if i % 2 == odd for one in row[name]]:
                print(name, what, table(some))


if __name__ == "__main__":
    sys.exit(main())
