"""Run as a script in another process: what the sunspin of its path gives, as JSON of names and values or digests on its output.

It uses public names and commands, and nothing else of the package: so it runs with the package of any commit that has them.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import io
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import sunspin as ss

SUN = [0.1959, 0.5690, 0.7986]

REFUSED = (
    "check nowhere.toml t.csv",
    "check philae nowhere.csv",
    "check philae",
    "sun philae philae --noise=-1",
    "rates philae",
    "simulate philae --omega 1,2",
    "simulate philae --omega 0.1,0.2,0.3 --sun 0,0,9 --duration 10",
    "scan philae philae --omega-x=0:1",
    "posterior philae --phase descnt",
    "posterior philae philae --prior=nothing=1",
    "outcomes philae --runs 0",
    "outcomes philae --strategy nothing",
    "reproduce --candidates nowhere.csv",
    "reproduce --calibrate -1",
    "export nowhere --format aem",
    "report nowhere",
    "compare nowhere nowhere",
    "decode nowhere.csv",
    "simulat",
    "worth --twins 0",
    "calibrate-sensors philae",
)
"""Calls whose sentence and exit code are compared; --out is given to none, and nothing is written."""


def digest(*arrays: Any) -> str:
    """The beginning of the SHA-256 over kinds, shapes and bytes of arrays."""
    found = hashlib.sha256()
    for array in map(np.asarray, arrays):
        found.update(f"{array.dtype} {array.shape} ".encode())
        found.update(
            array.astype("U").tobytes()
            if array.dtype == object
            else np.ascontiguousarray(array).tobytes()
        )
    return found.hexdigest()[:16]


def of_dataset(data: xr.Dataset | xr.DataArray) -> str:
    data = data.to_dataset(name="value") if isinstance(data, xr.DataArray) else data
    names = sorted(map(str, data.variables))
    return digest(names, *(data[name].values for name in names))


def of_tree(tree: xr.DataTree) -> str:
    return digest([f"{node.path} {of_dataset(node.to_dataset())}" for node in tree.subtree])


def body(n_wheels: int) -> ss.Vehicle:
    """A box with six panels and wheels on random axes that come to rest."""
    rng = np.random.default_rng(n_wheels)
    axes = rng.normal(size=(n_wheels, 3))
    wheels = [
        ss.Wheel(
            f"w{i}", axis / np.linalg.norm(axis), 0.0002, 20.0, ss.Friction(2e-6 * (i + 1), 1e-7)
        )
        for i, axis in enumerate(axes)
    ]
    faces = {
        "px": [1, 0, 0],
        "mx": [-1, 0, 0],
        "py": [0, 1, 0],
        "my": [0, -1, 0],
        "pz": [0, 0, 1],
        "mz": [0, 0, -1],
    }
    panels = [ss.Panel(name, normal, 2.0) for name, normal in faces.items()]
    inertia = np.diag([0.011, 0.014, 0.018]) + 0.0004 * (np.ones((3, 3)) - np.eye(3))
    return ss.Vehicle("box", inertia, 3.0, panels=panels, wheels=wheels, gain_unit="W")


def kernels() -> dict[str, Any]:
    """Distributions, directions and trajectories of bodies without, with one and with two wheels."""
    found, axis = {}, np.linspace(-0.3, 0.3, 7)
    for n in range(3):
        vehicle, speeds = body(n), [20.0] * n
        run = ss.propagate(
            vehicle, [0.1, -0.05, 0.02], SUN, speeds or None, np.arange(0.0, 601.0, 60.0)
        )
        found[f"propagate, {n} wheels"] = of_dataset(run)
        found[f"scan, {n} wheels"] = of_dataset(
            ss.scan(vehicle, [0.2, 0.5, 0.9], SUN, axis, axis, axis, speeds or None, 600.0)
        )
        found[f"E, {n} wheels"] = of_dataset(
            ss.scan(vehicle, run[["sun_B"]], SUN, axis, axis, axis, speeds or None)
        )
    philae = ss.load_vehicle("philae")
    found["scan, Philae"] = of_dataset(
        ss.scan(philae, [0.2, 0.5, 0.9], SUN, axis, axis, axis, 865.0, 2700.0)
    )
    found["outcomes, Philae"] = of_dataset(
        ss.outcomes(philae, [[0.1, -0.05, 0.02], [0.2, 0.1, 0.0]], "off", 400, 3)
    )
    return found


def golden() -> dict[str, Any]:
    """The golden run of the package's own tests."""
    sys.path.insert(0, str(Path(ss.__file__).parents[2] / "tests"))
    from test_golden import made

    return {f"golden, {part}": digest(np.array(values)) for part, values in made().items()}


def telemetry(seed: int, n: int = 12) -> tuple[ss.Vehicle, xr.Dataset]:
    """Samples of a tumbling box, 20 s apart, give or take three."""
    rng = np.random.default_rng(seed)
    vehicle = body(0)
    t = 20.0 * np.arange(n) + rng.uniform(-3, 3, n)
    sun = rng.normal(size=3)
    truth = {
        "omega_B": rng.uniform(-0.06, 0.06, 3),
        "sun_B": sun / np.linalg.norm(sun),
        "t_s": t - t[0],
        "noise": 0.02,
    }
    return vehicle, ss.twin(vehicle, truth, seed=seed)


def estimates(seed: int) -> dict[str, Any]:
    """Directions, rates and posterior of a simulated pass."""
    vehicle, data = telemetry(seed)
    tree = ss.posterior(vehicle, data, {"max_rate_rad_s": 0.12, "inertia": 0.0}, seed=seed)
    return {
        f"sun {seed}": of_dataset(ss.sun_directions(vehicle, data)),
        f"rates {seed}": of_dataset(ss.rates(vehicle, data, max_rate_rad_s=0.15)),
        f"posterior {seed}": [of_tree(tree), str(tree.attrs["verdict"])],
    }


def study(coarser: int) -> dict[str, Any]:
    """Every row, sentence and count of the Philae study."""
    with (
        tempfile.TemporaryDirectory() as home,
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        ss.reproduce(Path(home) / "out", coarser=coarser, calibrate=40)
        summary = json.loads((Path(home) / "out" / "summary.json").read_text("utf-8"))
        files = sorted(path.name for path in (Path(home) / "out").iterdir())
    found: dict[str, Any] = {f"row {row['id']}": row for row in summary["figures"]}
    found |= {
        f"summary {key}": summary.get(key)
        for key in ("headline", "conclusions", "score", "chain", "synthetic_telemetry")
    }
    return found | {"files of reproduce": files}


def face() -> dict[str, Any]:
    """Public names with their parameters; commands with their options; what is refused, how, and with which code."""
    import click

    from sunspin.cli import cli, main
    from sunspin.cli.common import COMMANDS

    found: dict[str, Any] = {}
    for name in sorted(ss.__all__):
        value = getattr(ss, name)
        is_error = inspect.isclass(value) and issubclass(value, Exception)
        found[f"ss.{name}"] = (
            str(inspect.signature(value))
            if callable(value) and not is_error
            else type(value).__name__
        )
    for name in COMMANDS:
        command = cli.get_command(click.Context(cli), name)
        found[f"help {name}"] = (
            command.get_help(click.Context(command, info_name=name)) if command else None
        )
    for line in REFUSED:
        said = io.StringIO()
        sys.argv = ["sunspin", *line.split()]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            try:
                main()
                code: Any = 0
            except SystemExit as end:
                code = end.code
        found[f"refused {line}"] = [code, said.getvalue()]
    return found


def without_places(value: Any) -> Any:
    """The same without names of modules, which may move."""
    text = json.dumps(value, sort_keys=True, default=str)
    return json.loads(re.sub(r"sunspin(\.[a-z_]+)+", "sunspin", text))


PARTS: dict[str, Callable[[int], dict[str, Any]]] = {
    "kernels": lambda _: kernels(),
    "golden": lambda _: golden(),
    "face": lambda _: face(),
    "estimates": estimates,
    "study": study,
}
"""Name of a part -> its results, of a number: which pass, or how coarse a study."""


def probe(part: str, n: int) -> dict[str, Any]:
    """A part, computed in a folder of its own."""
    with tempfile.TemporaryDirectory() as home:
        os.chdir(home)  # nothing lies about that a call might find
        return without_places(PARTS[part](n))


if __name__ == "__main__":
    results = probe(sys.argv[1], int(sys.argv[2]))
    print(json.dumps(results))
