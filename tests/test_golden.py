"""A golden run: the numbers that results hang on must not move unseen.

Stored from this machine (x86-64, AVX-512) on 2026-10; the bounds are what other processors, compilers and library versions
may change. Whoever moves a number beyond its bound on purpose stores it anew with ``python tests/test_golden.py``, which prints
by how much each part has moved and the line with which CHANGELOG.md has to say so.
"""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle import Vehicle

STORED = Path(__file__).with_name("golden.json")
SUN = [0.1959, 0.5690, 0.7986]

BOUNDS = {
    "reference": 1e-9,  # tolerance 1e-15 a step; other contractions of products grow with the way turned, some 300 rad
    "directions": 1e-12,  # closed arithmetic of a few panels
    "emd": 2e-4,  # single precision, whose bits hang on the width of the vectors; asked for to 1e-3
    "E": 1e-5,  # directions asked for to 1e-3; what they reach is far closer
    "impact": 1e-12,  # one linear system
    "outcomes": 0.02,  # shares of 400 runs: a run near the edge of an outcome may fall to the other side
}
"""Largest difference allowed, absolute."""


def made(philae: Vehicle | None = None) -> dict[str, list[float]]:
    """The numbers of this machine."""
    philae = philae or ss.load_vehicle("philae")
    run = ss.propagate(philae, [0.1, -0.05, 0.02], SUN, 865.0, [0.0, 600.0, 2700.0])
    rng = np.random.default_rng(1)
    suns = rng.normal(size=(40, 3))
    suns /= np.linalg.norm(suns, axis=1)[:, None]
    power = ss.panel_power(philae, suns) + rng.uniform(0, 2, (40, 6))
    told = ss.sun_directions(philae, power, noise=1.0)
    axes = [np.linspace(-0.2, 0.4, 3), np.linspace(-0.1, 0.3, 3), np.linspace(-0.1, 0.1, 2)]
    emd = ss.scan(philae, [0.2, 0.5, 0.9], SUN, *axes, 865.0, 2700.0)
    track = ss.propagate(philae, [0.11, -0.04, 0.02], SUN, 865.0, np.arange(0, 301, 60.0))
    error = ss.scan(philae, track[["sun_B"]], SUN, *axes, 865.0)
    hit = ss.impact(philae, [0.1, 0.2, 0.3], 300.0, [0.01, -0.1, -0.3], "2")
    outcomes = ss.outcomes(philae, [[0.1, -0.05, 0.02], [0.2, 0.1, 0.0]], "off", 400, 3)
    return {
        "reference": [
            *run["sun_B"].values.ravel(),
            *run["omega_B"].values.ravel(),
            run["event_time_s"].values[0] / 1000,
        ],
        "directions": np.nan_to_num(
            [*told["sun_B"].values.ravel(), *told["delta"].values, *told["sigma_rad"].values]
        ).tolist(),
        "emd": emd.values.ravel().tolist(),
        "E": error.values.ravel().tolist(),
        "impact": [
            *hit["omega_B"].values,
            *hit["velocity_B"].values,
            hit["wheel_speed_rad_s"].values[0] / 1000,
        ],
        "outcomes": [
            float(np.mean(outcomes["rz_share"].values[:, :20].sum(axis=1))),
            float(np.nanmean(outcomes["speed_after"])),
            *(float(np.mean(outcomes["contact_point"].values == k)) for k in range(3)),
        ],
    }


@pytest.fixture(scope="module")
def now():
    return made()


@pytest.mark.parametrize("part", BOUNDS)
def test_the_golden_run_has_not_moved(part, now):
    stored = json.loads(STORED.read_text("utf-8"))
    np.testing.assert_allclose(now[part], stored[part], rtol=0, atol=BOUNDS[part])


def test_the_same_machine_gives_the_same_bits(now):
    assert made() == now


def test_the_changes_say_by_how_much_it_moved():
    assert f"Golden run {mark()}" in (STORED.parents[1] / "CHANGELOG.md").read_text("utf-8")


def test_it_would_notice_a_part_in_a_million(now):
    """One moment of inertia larger by 1e-6: far below every physical error, and far beyond the bounds."""
    philae = ss.load_vehicle("philae")
    other = made(
        replace(
            philae,
            inertia_kg_m2=philae.inertia_kg_m2
            + np.diag([0.0, 1e-6 * philae.inertia_kg_m2[1, 1], 0.0]),
        )
    )
    for part in ("reference", "impact"):
        assert np.abs(np.subtract(other[part], now[part])).max() > 10 * BOUNDS[part], part
    assert other["directions"] == now["directions"]  # which no inertia enters


def mark() -> str:
    """The name of the numbers stored."""
    return hashlib.sha256(STORED.read_bytes()).hexdigest()[:8]


def store() -> str:
    """Store this machine's numbers; the line for the changes."""
    before, after = (
        json.loads(STORED.read_text("utf-8")),
        {part: [float(x) for x in v] for part, v in made().items()},
    )
    moved = {part: float(np.abs(np.subtract(after[part], before[part])).max()) for part in BOUNDS}
    STORED.write_text(json.dumps(after, indent=1) + "\n", "utf-8")
    return (
        f"- Golden run {mark()}: "
        + ", ".join(f"{part} moved by {size:.1e}" for part, size in moved.items())
        + "."
    )


if __name__ == "__main__":
    print(store())
