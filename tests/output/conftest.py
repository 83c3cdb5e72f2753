"""Small results folders for the report's tests, each made once by the code that makes the large ones."""

from __future__ import annotations

import fcntl
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sunspin.cases import load_case
from sunspin.output import figures
from sunspin.philae import data_check, motions, pictures, published_lines, reproduction, threshold
from sunspin.philae import study as rp
from tests.support.browser import HOSTILE, Browser, chromium
from tests.support.figures import blank
from tests.support.study import leave_out


def shared_folder(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """Return the folder `name` of this test run, which the first worker that needs it fills by `make`. It is only read."""
    base = factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder, done = root / name, root / f"{name}.done"
    with open(root / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


@contextmanager
def small() -> Iterator[None]:
    """A study of few motions and runs, without files of figures and the slowest parts that the page does not draw."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in (
            (motions, "SPREAD_MOTIONS", 4),
            (published_lines, "LINE_POINTS", 3),
            (published_lines, "POOL_POINTS", 4),
            (threshold, "BLOCK", 64),
            (data_check, "SHUFFLES", 1),
            (rp, "LEAST_RUNS", 40),
            (rp, "LANDING_RUNS", 1),
            (pictures, "list_drawings", lambda _: iter(())),
            (figures, "render", blank),
        ):
            patch.setattr(module, name, value)
        leave_out(patch, "precession", "sensitivity")
        yield


@pytest.fixture(scope="session")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `sunspin reproduce` writes, from a coarse grid and few runs."""

    def make(folder: Path) -> None:
        with small():
            reproduction.reproduce(folder, **SMALL_STUDY)

    return shared_folder(tmp_path_factory, "study", make)


@pytest.fixture(scope="session")
def no_conclusion(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same from a file that carries no conclusion: each panel's readings in random order within their phase."""

    def make(root: Path) -> None:
        lines = (load_case("philae").folder / "telemetry.csv").read_text("utf-8").splitlines()
        comments, (head, *body) = (
            [line for line in lines if line.startswith("#") is wanted] for wanted in (True, False)
        )
        table, rng = np.array([line.split(",") for line in body]), np.random.default_rng(1)
        names = head.split(",")
        for name in np.unique(table[:, names.index("phase")]):
            at = np.flatnonzero(table[:, names.index("phase")] == name)
            for k in (k for k, column in enumerate(names) if column.endswith("_W")):
                table[at, k] = table[rng.permutation(at), k]
        telemetry = root / "shuffled.csv"
        text = "\n".join([*comments, head, *(",".join(row) for row in table)]) + "\n"
        telemetry.write_text(text, "utf-8")
        with small():
            reproduction.reproduce(root / "results", telemetry, **SMALL_STUDY)

    return shared_folder(tmp_path_factory, "shuffled", make) / "results"


SMALL_STUDY = {"coarser": 25, "calibrate": 30, "posterior": False, "workers": 1}
"""Synthetic rebounds of the calibration: enough for a 90 % level."""


@pytest.fixture(scope="session")
def user_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of the commands for a user's own vehicle, whose name and panels are hostile, and their pages; `sun` alone
    draws figures, all others write empty ones: figures have tests of their own."""
    from sunspin.cli import cli

    def make(root: Path) -> None:
        run = CliRunner()

        def sunspin(*arguments: str) -> None:
            with pytest.MonkeyPatch.context() as patch:
                # kept with the results as the line that repeats them
                patch.setattr(sys, "argv", ["sunspin", *arguments])
                if arguments[0] != "sun" and arguments[1] != str(root / "sun"):
                    patch.setattr(figures, "render", blank)
                done = run.invoke(cli, arguments, catch_exceptions=False)
            assert done.exit_code == 0, done.output

        sunspin("init", str(root / "mine"))
        vehicle, telemetry = root / "mine" / "vehicle.toml", root / "mine" / "telemetry.csv"
        text = vehicle.read_text("utf-8").replace('name = "my satellite"', f"name = '{HOSTILE}'")
        # finding it takes as long again
        text = text.replace("# acceleration_noise = 1e-5", "acceleration_noise = 1e-5")
        assert HOSTILE in text and "\nacceleration_noise" in text
        vehicle.write_text(text, "utf-8")
        lines = telemetry.read_text("utf-8").splitlines(keepends=True)
        telemetry.write_text("".join(lines[:SAMPLES]), "utf-8")
        data = str(vehicle), str(telemetry)
        sunspin("sun", *data, "--out", str(root / "sun"))
        quick = "--max-rate-deg-s=5", "--effort=0.1", "--no-column-tests", "--workers=1"
        sunspin("rates", *data, *quick, "--out", str(root / "rates"))
        grid = [f"--omega-{axis}-deg-s=-6:6:3" for axis in "xyz"]
        sunspin("scan", *data, *grid, "--lines", "0", "--out", str(root / "scan"))
        known = [f"--prior={key}=0" for key in "inertia friction wheel_speed steady_torque".split()]
        # half the draws of the default take half the time
        few = "--prior=max_rate_rad_s=0.1", "--draws=200", "--predict=0,600", "--workers=1"
        sunspin("posterior", *data, *known, *few, "--out", str(root / "posterior"))
        motion = "--omega-deg-s=1.146,-1.719,2.865", "--sun=0.5,0.4,0.768", "--duration=300"
        sunspin("simulate", str(vehicle), *motion, "--out", str(root / "simulate"))
        runs = "outcomes philae --runs 20 --strategy off --strategy held --workers 1 --out".split()
        sunspin(*runs, str(root / "outcomes"))
        for name in RUNS:
            sunspin("report", str(root / name))

    root = shared_folder(tmp_path_factory, "user", make)
    return {name: root / name for name in RUNS}


RUNS = ("sun", "rates", "scan", "simulate", "posterior", "outcomes")
"""Commands whose results there are, each with its page."""


SAMPLES = 12
"""Lines of the telemetry that are kept: `rates` takes the longer the more samples there are."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One Chromium for all tests; where there is none they are skipped, but in CI (environment variable CI) they fail."""
    if chromium() is None:
        text = "no chromium on this machine: apt-get install chromium"
        pytest.fail(text) if os.environ.get("CI") else pytest.skip(text)
    one = Browser(tmp_path_factory.mktemp("browser"))
    yield one
    one.close()
