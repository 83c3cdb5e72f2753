"""Cases of the scoreboard: each area yields its tasks for a level ("quick", "full") and a seed.

The criteria are in the modules of the campaigns; here their result becomes an outcome of :data:`validation.scoreboard.OUTCOMES`.
Those modules are imported inside functions: every case runs in its own process, which should not load all of them.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from sunspin.base.errors import SunspinError
from validation.scoreboard import Task
from validation.truths import WRONG_SIGMAS

Row = dict[str, Any]

CONFIDENT = ("unique", "aliases", "line")
"""Words of a posterior's verdict that name one or a few solutions."""


def passes(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `rates`: simulated passes of every kind, made without the package's own dynamics and panel model."""
    from validation.passes import KINDS

    for kind, count in KINDS.items():
        for i in range(4 if level == "quick" else count // 2):
            yield Task("rates", kind, f"{seed}/{i}", partial(_pass, kind, seed, i))
    for i in range(4 if level == "quick" else 24):
        yield Task("rates", "any vehicle", f"{seed}/{i}", partial(_any_vehicle, seed, i))
    for kind in ("several passes", "period"):
        for i in range(4 if level == "quick" else 12):
            yield Task("rates", kind, f"{seed}/{i}", partial(_several, kind, seed, i))


EXCHANGED = ("columns exchanged", "exchanged, six panels")
"""Kinds of passes whose file has two columns exchanged."""


def _pass(kind: str, seed: int, i: int) -> Row:
    """Run and judge simulated pass `i` of a kind."""
    from validation.passes import judge

    row = judge(kind, seed, i)
    if "pull" not in row:
        return {"outcome": "open", "says": row["why"], "listed": False}
    # a mirrored motion is the right reading of a file whose columns are exchanged
    wrong = row["wrong"] or row["empty"] or (row["mirrored"] and kind not in EXCHANGED)
    if row["decided"] and wrong:
        outcome = "wrong"
    elif kind in EXCHANGED and row["named"]:
        # the pass is then not decided, and the operator corrects the file: the true exchange must be named
        outcome = "right" if row["named_rightly"] else "wrong"
    elif row["mirrored"]:
        outcome = "open"
    elif row["decided"]:
        outcome = "right"
    else:
        # undecided counts against the package only if its best solution is right and constrained
        best_is_right = not (row["wrong"] or row["empty"])
        outcome = "undecided" if row["leads"] and best_is_right else "open"
    return {
        "outcome": outcome,
        "says": row["why"],
        "listed": row["listed"],
        "off": row["off_deg_s"],
        "sigma": row["sigma_deg_s"],
    }


def _any_vehicle(seed: int, i: int) -> Row:
    """Run and judge `rates` on random vehicle `i`."""
    from sunspin.estimate.verdict import DECIDED
    from tests.support.any_vehicle import judge_rates

    row = judge_rates(seed, i)
    if row["word"] == "refused":
        return {"outcome": "open", "says": row["verdict"], "listed": False}
    if row["word"] == "decided":
        outcome = "wrong" if row["probability"] < 1 - DECIDED else "right"
    else:
        outcome = "undecided" if row["best"] else "open"
    error = np.array(row["miss_deg_s"])
    return {
        "outcome": outcome,
        "says": row["verdict"],
        "listed": row["listed"],
        "off": error.tolist(),
        "sigma": (error / row["pulls"]).tolist(),  # a normalised error is error / sigma
    }


def _several(kind: str, seed: int, i: int) -> Row:
    """Run and judge `rates` on file `i` with several sparse passes, or with one and a period that was seen."""
    from validation.many_passes import judge

    return _of_passes(judge(kind, seed, i), "off_deg_s", "sigma_deg_s")


def orbiting(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `rates`: CubeSats with a dipole, clouds and real elements, with and without a magnetometer and the orbit."""
    for i in range(1 if level == "quick" else 8):
        yield Task("rates", "in orbit", f"{seed}/{i}", partial(_orbiting, seed, i))
    for i in range(1 if level == "quick" else 6):
        yield Task(
            "rates",
            "in orbit, whole turns between samples",
            f"{seed}/{i}",
            partial(_sparse, seed, i),
        )


def _orbiting(seed: int, i: int) -> Row:
    """Run and judge `rates` on satellite `i` in orbit, without elements, with the right ones, and with the magnetic field alone."""
    from tests.support.orbit_cases import judge_rates

    row = judge_rates(seed, i)
    ways = ("without", "right", "field alone")
    passes = [each for way in ways if way in row for each in row[way]["passes"]]
    judged = [each for each in passes if "pulls" in each]
    listed = all(each["listed"] for each in passes)
    return _of_passes(judged, "miss_deg_s", "sigma_deg_s") | {"listed": listed}


def _sparse(seed: int, i: int) -> Row:
    """Run and judge `rates` on sparse samples of satellite `i` in orbit, several revolutions apart."""
    import sunspin as ss
    from tests.support.orbit_cases import SPARSE, one_pass, pass_against_truth, rates_case

    vehicle, data, _, truth, about = rates_case(seed, i, **SPARSE)
    results = [
        ss.rates(vehicle, one_pass(data, begin).drop_vars("field_B")) for begin in about["begin_s"]
    ]
    return _of_passes(
        [pass_against_truth(result, truth, 0) for result in results], "miss_deg_s", "sigma_deg_s"
    )


def _of_passes(passes: list[Row], off: str, sigma: str) -> Row:
    """Return the row of a file with several passes, whose keys `off` and `sigma` hold errors and sigmas of each component."""
    decided = [each for each in passes if each["decided"]]
    if any(each["wrong"] for each in decided):
        outcome = "wrong"
    elif decided:
        outcome = "right"
    else:
        outcome = "open" if all(each["wrong"] for each in passes) else "undecided"
    return {
        "outcome": outcome,
        "listed": all(each["listed"] for each in passes),
        "off": [value for each in decided for value in each[off]],
        "sigma": [value for each in decided for value in each[sigma]],
        "measured": {"decided": len(decided), "passes": len(passes)},
    }


def posteriors(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `posterior`: right models, unmodelled torques, wrong moments, misaligned panels, wrong models."""
    from validation.torques import LEVELS

    for kind in LEVELS:
        for i in range(4 if level == "quick" else 12):
            yield Task(
                "posterior",
                _KINDS_OF_TORQUE.get(kind, f"torque {kind}"),
                f"{seed}/{i}",
                partial(_torque, kind, seed, i),
            )
    counts = {"known": (1, 6), "unknown": (3, 10), "swapped": (1, 6), "wheel_off": (1, 6)}
    for kind, (few, many) in counts.items():
        for i in range(few if level == "quick" else many):
            yield Task("posterior", kind, f"{seed}/{i}", partial(_philae_by_package, kind, seed, i))
    for i in range(2 if level == "quick" else 12):
        yield Task("posterior", "any vehicle", f"{seed}/{i}", partial(_any_posterior, seed, i))
    if level == "full":
        for i in range(6):
            yield Task(
                "posterior",
                "turned, two minutes apart",
                f"{seed}/{i}",
                partial(_philae_by_package, "turned", seed, i, 0.3, 23, 120.0),
            )
    for i in (2,) if level == "quick" else (0, 2, 3, 5, 6, 10, 11, 12, 13, 14, 15, 16):
        yield Task(
            "posterior",
            "Philae, simulated",
            f"{seed}/{i}",
            partial(_philae_without_package, seed, i),
        )


_KINDS_OF_TORQUE = {"0": "right model", "inertia": "moments off by 5 %"}


def _torque(kind: str, seed: int, i: int) -> Row:
    """Run and judge the posterior of box `i` with a torque of this level."""
    from validation.torques import judge

    row = judge(kind, seed, i)
    if row["word"] == "refused":
        return {"outcome": "defect", "says": row["verdict"], "listed": False}
    near = min(row["far"]) < WRONG_SIGMAS
    outcome = "wrong" if row["wrong"] else _of_word(row["word"], near)
    return {
        "outcome": outcome,
        "says": row["verdict"],
        "listed": row["listed"],
        "off": row["error"],
        "sigma": row["sigma"] * np.sqrt(3),
        "level": row["level"],
    }


def _of_word(word: str, near: bool) -> str:
    """Return the outcome for the `word` of a posterior's verdict, if the file's model is right.

    `near` says whether a listed solution is the truth.
    """
    if word in CONFIDENT:
        return "right" if near else "wrong"
    return "wrong" if word == "not explained" else "undecided" if near else "open"


def _philae_by_package(
    kind: str, seed: int, i: int, max_rate: float = 0.25, samples: int = 16, apart_s: float = 20.0
) -> Row:
    """Run and judge the posterior of Philae case `i` of a kind, simulated with the package's own model.

    Telemetry of "swapped" and "wheel_off" follows another model: right is to refuse it, or to find that no motion explains it.
    """
    from sunspin.cases import load_case
    from validation.calibrate import judge, make

    vehicle = load_case("philae").vehicle
    case = make(vehicle, kind, max_rate, samples, apart_s, seed, i)
    try:
        row = judge(vehicle, case, seed)
    except SunspinError as error:
        return {
            "outcome": "right" if kind in ("swapped", "wheel_off") else "defect",
            "says": str(error),
        }
    if kind in ("swapped", "wheel_off"):
        if row["word"] == "not explained":
            outcome = "right"
        else:
            outcome = "wrong" if row["word"] in CONFIDENT and not row["recalled"] else "open"
        return {"outcome": outcome, "says": row["verdict"]}
    outcome = _of_word(row["word"], row["recalled"])
    return {
        "outcome": outcome,
        "says": row["verdict"],
        "listed": row["listed"],
        "off": row["error"],
        "sigma": row["sigma"],
        "level": row["level"],
    }


def _any_posterior(seed: int, i: int) -> Row:
    """Run and judge the posterior of random vehicle `i`."""
    from tests.support.any_vehicle import judge_posterior, posterior_case
    from validation.calibrate import NEAR_SIGMAS

    row = judge_posterior(posterior_case(seed, i), workers=1)
    if row["word"] == "refused":
        return {"outcome": "open", "says": row["verdict"], "listed": False}
    return {
        "outcome": _of_word(row["word"], row["sigmas"] < NEAR_SIGMAS),
        "says": row["verdict"],
        "listed": row["listed"],
        "off": row["error"],
        "sigma": row["sigma"],
        "level": row["level"],
    }


def _philae_without_package(seed: int, i: int) -> Row:
    """Run and judge the posterior of Philae case `i` that was simulated without the package."""
    from validation.posterior_cases import LIMIT_S, cases, run_limited

    case = next(case for case in cases(seed) if case.number == i)
    row = run_limited(case, LIMIT_S)
    outcome = "open" if row["word"] == "did not end" else _of_word(row["word"], row["recalled"])
    return {
        "outcome": outcome,
        "says": row["verdict"] or row["word"],
        "listed": row["listed"],
        "processor_s": row["processor_s"],
    }


def spinners(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks on a spinner with a magnetometer: verdicts on right and wrong elements, and rates with and without elements."""
    from validation.spinners import cases

    for case in cases(seed, 4 if level == "quick" else 20, whole=True):
        for elements in ("right", "wrong"):
            yield Task(
                "orbit",
                f"spinner, node {elements}",
                f"{seed}/{case.number}",
                partial(_spinner, seed, case.number, elements),
            )
    for number in (4,) if level == "quick" else (1, 3, 4, 5, 6, 9, 10, 12, 13, 14):
        for elements in ("none", "right"):
            kind = f"spinner, elements {elements}"
            yield Task(
                "rates", kind, f"{seed}/{number}", partial(_spinning, seed, number, elements)
            )


def _spinner(seed: int, number: int, elements: str) -> Row:
    """Judge the check of right or wrong elements on a spinner; that of the first one as the command has it."""
    from validation.spinners import cases, check_elements, run

    case = cases(seed, number + 1, whole=True)[number]
    with tempfile.TemporaryDirectory() as folder:
        if number == 0:
            row = run(case, Path(folder), f"check {elements}")
        else:
            row = check_elements(case, Path(folder), elements)
    if row["defect"] or "orbit" not in row:
        return {"outcome": "defect", "says": row.get("error", "")}
    return {
        "outcome": _of_orbit(row["orbit"]["verdict"], elements == "right"),
        "says": row["orbit"]["verdict"],
    }


def _of_orbit(verdict: str, right: bool) -> str:
    """Return the outcome of a verdict on elements that are `right` or not."""
    if verdict == "undecided":
        return "undecided" if right else "open"
    return "right" if (verdict == "fits") is right else "wrong"


def _spinning(seed: int, number: int, elements: str) -> Row:
    """Run and judge `rates` on a spinner with these elements."""
    from validation.spinners import cases, run

    with tempfile.TemporaryDirectory() as folder:
        row = run(cases(seed, number + 1)[number], Path(folder), f"rates {elements}")
    if row["defect"] or "passes" not in row:
        return {"outcome": "defect", "says": row.get("error", "")}
    return _of_passes(row["passes"], "off_all", "sigma_all")


def elements(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `check --tle`: right elements, a node that is off, a clock that is an hour behind."""
    for i in range(3 if level == "quick" else 10):
        yield Task(
            "orbit",
            "CubeSat: right, node off by 20 deg, clock off",
            f"{seed}/{i}",
            partial(_elements, seed, i),
        )


def _elements(seed: int, i: int) -> Row:
    """Run and judge `check --tle` on CubeSat `i` with right and wrong elements; the worst outcome counts."""
    from tests.support.orbit_cases import judge_check

    row = judge_check(seed, i)
    verdicts = {name: row[name].verdict.name.lower() for name in ("0 deg", "20 deg", "clock")}
    outcomes = [_of_orbit(verdict, right=name == "0 deg") for name, verdict in verdicts.items()]
    worst = next(word for word in ("wrong", "undecided", "open", "right") if word in outcomes)
    # error of the along-track offset in s, with the right elements
    with_right = row["0 deg"]
    shift = {"off": with_right.shift_s - row["ahead_s"], "sigma": with_right.shift_sigma_s}
    return {"outcome": worst, "says": str(verdicts)} | shift


def calibration(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `calibrate-sensors`: sensors with known errors, or with none."""
    for i in range(2 if level == "quick" else 16):
        kind = "sensors as stated" if i % 2 else "sensors off"
        yield Task("calibrate-sensors", kind, f"{seed}/{i}", partial(_calibration, seed, i))


def _calibration(seed: int, i: int) -> Row:
    """Run and judge the calibration of sensors of file `i`."""
    from tests.support.calibration_cases import judge_calibration

    # normalised errors of each calibrated key of the vehicle file
    (errors_of_key,) = judge_calibration(seed, i).values()
    errors = [error for values in errors_of_key.values() for error in values]
    wrong = [
        f"{key}: {max(values, key=abs):.1f} sigma off"
        for key, values in errors_of_key.items()
        if max(map(abs, values)) > WRONG_SIGMAS
    ]
    outcome = "wrong" if wrong else "right" if errors else "undecided"
    return {
        "outcome": outcome,
        "says": "; ".join(wrong),
        "off": errors,
        "sigma": [1.0] * len(errors),
    }


def exchanges(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `rates` on satellites with wings and wheels: two panel columns exchanged, and the right files."""
    from validation.exchanges import HIDDEN, QUICK, WHEEL_REVERSED

    for satellite in QUICK[:2] if level == "quick" else QUICK:
        for which in (-1, 0):
            kind = (
                "right file of a satellite with wings" if which < 0 else "columns exchanged on it"
            )
            yield Task(
                "wiring", kind, f"{seed}/{satellite}", partial(_exchange, seed, satellite, which)
            )
    # satellites with one wheel, that have odd numbers; every second one also with the right file
    for i in range(4 if level == "quick" else 24):
        satellite = 2 * i + 1
        yield Task(
            "wiring",
            "wheel the other way",
            f"{seed}/{satellite}",
            partial(_exchange, seed, satellite, WHEEL_REVERSED),
        )
        if i % 2 == 0:
            yield Task(
                "wiring",
                "right file of a satellite with a wheel",
                f"{seed}/{satellite}",
                partial(_exchange, seed, satellite, -1),
            )
    for satellite in QUICK[:1] if level == "quick" else QUICK:
        yield Task(
            "wiring",
            "columns exchanged that the samples hide",
            f"{seed}/{satellite}",
            partial(_exchange, seed, satellite, HIDDEN),
        )


_EXCHANGES = {
    "decided": "right",
    "named rightly": "right",
    "named among several": "right",
    "decided, and right within its errors": "right",
    "equivalent": "open",
    "undecided": "undecided",
    "accused": "wrong",
    "a false change named": "wrong",
    "decided wrongly": "wrong",
    "refused": "defect",
}
"""Outcomes of the campaign `exchanges` as outcomes of the scoreboard."""


def _exchange(seed: int, satellite: int, which: int) -> Row:
    """Run and judge exchange `which` of a satellite; -1 is the right file, other negative numbers as in `exchanges.run`."""
    from validation.exchanges import run

    row = run((seed, satellite, which))
    return {"outcome": _EXCHANGES[row["outcome"]], "says": f"{row['outcome']}: {row['verdict']}"}


def files(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `check` and `rates` on right files of every form, and of `check` on files with a fault."""
    for command, few, many in (("check", 10, 100), ("rates", 1, 15)):
        for i in range(few if level == "quick" else many):
            yield Task(command, "right file", f"{seed}/{i}", partial(_right_file, command, seed, i))
    for fault in FAULTS:
        for i in range(4 if level == "quick" else 30):
            yield Task("check", f"fault: {fault}", f"{seed}/{i}", partial(_fault, fault, seed, i))


def _right_file(command: str, seed: int, i: int) -> Row:
    """Run a command on right file `i`; every accusation is wrong."""
    from validation.right_files import judge

    with tempfile.TemporaryDirectory() as folder:
        accused = judge(Path(folder), seed, i, command)["accused"]
    return {"outcome": "wrong" if accused else "right", "says": "; ".join(accused)}


def _scale_brightest_panel(rows: list[Row], factor: float) -> None:
    """Multiply the readings of the panel with the largest sum by a factor."""
    panels = [key for key in rows[0] if key.startswith("i.")]
    brightest = max(panels, key=lambda name: sum(row[name] for row in rows))
    for row in rows:
        row[brightest] *= factor


def _write_panels_in_thousandths(rows: list[Row]) -> None:
    """Convert the readings of all panels to a thousandth of the unit."""
    for row in rows:
        row |= {key: 1e3 * value for key, value in row.items() if key.startswith("i.")}


def _rotate_sun_vector(rows: list[Row]) -> None:
    """Rotate the axes of the Sun vector by 90 degrees about z."""
    for row in rows:
        x, y, z = row["vector"]
        row["vector"] = [y, -x, z]


def _delete_gyro(rows: list[Row]) -> None:
    """Delete the gyro's columns."""
    for row in rows:
        del row["gyro"]


FAULTS: dict[str, tuple[str, str, Callable[[list[Row]], None]]] = {
    "dead panel": ("", "dead_panels", partial(_scale_brightest_panel, factor=0.0)),
    "weak panel": ("", "weak_panels", partial(_scale_brightest_panel, factor=0.85)),
    "thousandths": ("", "wrong_units", _write_panels_in_thousandths),
    "Sun vector along other axes": ("vector", "wrong_axes", _rotate_sun_vector),
    "columns of the gyro missing": ("gyro", "missing_sensors", _delete_gyro),
}
"""Each fault -> the sensor that it needs (empty: none), the key of `check --json` that has to name it, and the change of the rows,
which is made in place."""


def _fault(fault: str, seed: int, i: int) -> Row:
    """Run `check` on file `i` with a fault; the outcome is right if the fault is named or the file is refused."""
    from sunspin.cli.check import check
    from validation.right_files import make

    sensor, report_key, spoil = FAULTS[fault]
    with tempfile.TemporaryDirectory() as folder:
        vehicle, telemetry, form = make(Path(folder), seed, i)
        if sensor not in form:
            return {"outcome": "not run", "says": f"this file has no {sensor}"}
        rows = [json.loads(line) for line in telemetry.read_text("utf-8").splitlines()]
        spoil(rows)
        telemetry.write_text("".join(json.dumps(row) + "\n" for row in rows), "utf-8")
        done = CliRunner().invoke(check, [str(vehicle), str(telemetry), "--json"])
    says = json.loads(done.stdout)["telemetry"].get(report_key) if done.exit_code == 0 else None
    refused = done.exit_code == 2
    return {
        "outcome": "right" if says or refused else "undecided",
        "says": str(says or done.stderr)[:300],
    }


def exact(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks on exact physics: comparisons with other software, EMDs of the scan and of the reference integrator."""
    from validation.witnesses import WITNESSES

    if seed == 0:
        for witness in WITNESSES:
            yield Task("exact", "witnesses", witness.__name__, partial(_witness, witness.__name__))
    for block in range(1 if level == "quick" else 10):
        yield Task(
            "exact", "EMD of 50 motions", f"{seed}/{block}", partial(_distances, seed, block)
        )


def _witness(name: str) -> Row:
    """Run one witness of :mod:`validation.witnesses`."""
    from validation import witnesses

    rows = list(getattr(witnesses, name)())
    failed = [row.what for row in rows if not row.holds]
    return {
        "outcome": "wrong" if failed else "right",
        "says": "; ".join(failed),
        "measured": {f"digits, {row.what}": row.digits for row in rows},
    }


def _emd_bound() -> float:
    """Return the largest error of an EMD from histograms: half a bin for each sample, halved in the paper's distance."""
    from sunspin.estimate.scan.histogram import BINS

    return 2.0 / BINS / 4


def _distances(seed: int, block: int) -> Row:
    """Compare the EMD of 50 random motions, each rate within 0.4 rad/s, with that of the reference integrator."""
    from bench.problem import philae
    from bench.scan import reference_emd, scanned_emd

    rng, problem = np.random.default_rng([seed, block]), philae()
    largest = 0.0
    for omega in rng.uniform(-0.4, 0.4, (50, 3)):
        largest = max(largest, abs(scanned_emd(problem, omega) - reference_emd(problem, omega)))
    return {
        "outcome": "right" if largest < _emd_bound() else "wrong",
        "measured": {"largest difference": largest},
    }


def study(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks of `reproduce`: every row of the paper with its verdict, and negative controls."""
    from validation.controls import CONTROLS

    if seed:  # these cases do not depend on the seed
        return
    # kind -> grid of the scan: every n-th point
    grids = {"rows of the paper, coarse grid": 3}
    if level == "full":
        grids["rows of the paper"] = 1
    for kind, coarser in grids.items():
        yield Task("reproduce", kind, "built-in telemetry", partial(_reproduced, coarser))
    names = ("as it is", "each panel shuffled") if level == "quick" else tuple(CONTROLS)
    for name in names:
        yield Task("reproduce", "controls", name, partial(_control, name))


def _reproduced(coarser: int) -> Row:
    """Run `reproduce` on every n-th point (`coarser`) of the paper's grid, and return a case for each of its rows."""
    import sunspin as ss

    with tempfile.TemporaryDirectory() as folder:
        ss.reproduce(Path(folder) / "results", coarser=coarser, workers=1, posterior=False)
        summary = json.loads((Path(folder) / "results" / "summary.json").read_text("utf-8"))
    cases = {}
    for row in summary["figures"]:
        outcome = {True: "right", False: "wrong", None: "open"}[row["agrees"]]
        ours = _numbers(row["ours"])
        measured = {f"ours, {row['kind']}, {k}": number for k, number in enumerate(ours)}
        cases[row["id"]] = {"outcome": outcome, "measured": measured}
    return {"outcome": "right", "cases": cases}


def _numbers(value: Any) -> list[float]:
    """Return the numbers in nested lists, in their order."""
    if isinstance(value, list | dict):
        inside = value.values() if isinstance(value, dict) else value
        return [number for each in inside for number in _numbers(each)]
    return [float(value)] if isinstance(value, int | float) else []


def _control(name: str) -> Row:
    """Run a negative control and judge whether anything was concluded from it."""
    from sunspin.cases import load_case
    from validation.controls import CONTROLS, NOT_CONCLUDED, run_chain

    result = run_chain(CONTROLS[name](load_case("philae")))
    concluded = result.scan is not None and result.chain is not None
    may_conclude = name not in NOT_CONCLUDED
    outcome = "right" if concluded is may_conclude else "wrong"
    if not concluded:
        return {"outcome": outcome, "says": result.why}
    measured = {
        "smallest EMD": result.scan.smallest,
        "share of the box": result.chain.share,
        "speed at least": result.chain.chosen.speed_range()[0],
    }
    return {
        "outcome": outcome,
        "measured": measured | {"lines": float(result.scan.lines_recovered)},
    }


def real(_: str, seed: int) -> Iterator[Task]:
    """Yield tasks on real data: rates of skCUBE compared with its gyro, if the data are there."""
    from validation.real import SIDES

    if seed == 0:
        for side in SIDES:
            yield Task("real", "skCUBE against its gyro", side, partial(_skcube, side))


def _skcube(side: str) -> Row:
    """Estimate skCUBE's rates without its gyro, and judge them by the gyro."""
    import sunspin as ss
    from validation.real import SIDES, compare_with_gyro, fit_gyros

    path = Path(os.environ.get("SUNSPIN_DATA", "")) / "skcube" / "skcube_adcs.csv"
    if not os.environ.get("SUNSPIN_DATA") or not path.is_file():
        return {"outcome": "not run", "says": "no skcube/skcube_adcs.csv below SUNSPIN_DATA"}
    craft = ss.load_vehicle("skcube")
    data = ss.read_telemetry(path, craft)
    result = ss.rates(craft, data.drop_vars(SIDES[side]), workers=1)
    rows = [
        row
        for row in compare_with_gyro(craft, data, result, fit_gyros(craft, data))
        if np.isfinite(row.miss).all()
    ]
    # decided passes with the coils off, as the torque of driven coils is not modelled
    judged = [row for row in rows if row.free and row.status == "decided"]
    off = [value for row in judged for value in row.miss]
    sigma = [value for row in judged for value in np.hypot(row.sigma, row.gyro_sigma)]
    wrong = bool((np.abs(off) > WRONG_SIGMAS * np.array(sigma)).any())
    measured = {
        "decided": float(sum(row.status == "decided" for row in rows)),
        "with a gyro": float(len(rows)),
    }
    return {
        "outcome": "wrong" if wrong else "right",
        "off": off,
        "sigma": sigma,
        "measured": measured,
    }


INPUTS_PER_TASK = 20
"""Number of hostile inputs of one task."""


def hostile(level: str, seed: int) -> Iterator[Task]:
    """Yield tasks on hostile files and options: a result or an error message is right."""
    for block in range(3 if level == "quick" else 13):
        yield Task(
            "hostile",
            f"{INPUTS_PER_TASK} inputs",
            f"{seed}/{block}",
            partial(_hostile, seed, block),
        )


def _hostile(seed: int, block: int) -> Row:
    """Run the hostile inputs number `block` * `INPUTS_PER_TASK` and following; each finding is a defect."""
    from validation import pool
    from validation.fuzz import Fuzz

    report = pool.run(Fuzz, INPUTS_PER_TASK, first=INPUTS_PER_TASK * block, workers=1, seed=seed)
    says = "; ".join(
        f"{index}: {verdict.what}: {verdict.shown}" for index, verdict in report.findings
    )
    return {"outcome": "defect" if report.findings else "right", "says": says[:800]}


AREAS: dict[str, Callable[[str, int], Iterator[Task]]] = {
    "study": study,
    "posteriors": posteriors,
    "real": real,
    "passes": passes,
    "orbiting": orbiting,
    "spinners": spinners,
    "elements": elements,
    "exchanges": exchanges,
    "calibration": calibration,
    "exact": exact,
    "files": files,
    "hostile": hostile,
}
"""Areas by name, those whose cases take longest first, so that no core waits for a last long one."""
