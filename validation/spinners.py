"""Simulated spinners: a small satellite with coarse Sun sensors and a magnetometer with a large zero, in an orbit.

They are made without the package. SGP4 gives the position, IGRF the field, ERFA the Sun and the rotation of the Earth. The motion
is the closed form of a symmetric body with slow nutation, whose spin drifts by up to 1 % an orbit. The Earth reflects as a Lambert
sphere.
"""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import erfa
import numpy as np
import ppigrf
import xarray as xr
from click.testing import CliRunner
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec, jday

import sunspin as ss
from sunspin.base.errors import SunspinError
from sunspin.cli.check import check
from sunspin.environment.ephemeris import OrbitFile
from sunspin.estimate.orbit.check import check_orbit
from sunspin.estimate.orbit.judged import orbit_of
from sunspin.output.check.orbit import choose_orbit
from sunspin.telemetry.assess import assess
from tests.support.orbits import with_check_digit, with_node_turned
from tests.support.vehicles import FACES
from validation.truths import is_listed, is_wrong

EARTH_KM, ORBIT_S = 6371.0, 5600.0
SUN_NOISE = 0.01
"""Noise of a coarse Sun sensor, as a part of its full reading."""

GAIN_A, FIELD_NOISE_NT = 0.02, 300.0
ZERO_OFF, ZERO_OPEN = 0.2, 3.0
"""Error of a stated zero and sigma of an unknown one, as parts of the usual field (35 uT)."""

SEEN = 0.25
"""Least part of the day in which some panel sees the Sun; a file without it says nothing without an orbit."""

USUAL_NT = 35_000.0
WRONG_NODE_DEG = 20.0


AS_MOUNTED = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
"""Axes of a magnetometer that is not rotated, in the form of `Case`."""


class Case(NamedTuple):
    """Parameters of one simulated file.

    `axis`: index of the spin axis. `faces`: names of panels. `turned` (3, 3): rows of a signed permutation, the axis along which
    each column of the magnetometer reads. `zero` (3): zero of the magnetometer, in units of the usual field. `zero_known`: the
    vehicle file states it. `moments`: moment about the spin axis over that across.
    """

    seed: int
    number: int
    spin_deg_s: float
    axis: int
    nutation_deg: float
    faces: tuple[str, ...]
    turned: tuple[tuple[int, ...], ...]
    zero: tuple[float, ...]
    zero_known: bool
    moments: float
    inertia_known: bool
    albedo: float
    step_s: float
    samples: int

    @property
    def whole_orbit(self) -> bool:
        """True if the file covers an orbit."""
        return self.samples * self.step_s > 0.95 * ORBIT_S


def cases(seed: int, count: int, whole: bool | None = None) -> list[Case]:
    """Draw cases from a seed: all over a whole orbit (`whole` true), all shorter (false), or half of each (None)."""
    return [
        _draw_case(seed, number, number % 2 == 0 if whole is None else whole)
        for number in range(count)
    ]


def _draw_case(seed: int, number: int, whole: bool) -> Case:
    """Draw the parameters of one case; a file has at least 76 samples, over an orbit if `whole`.

    The interval is the longest or the second longest of four in which the body rotates by less than 100 degrees.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    speed = float(10 ** rng.uniform(np.log10(0.2), np.log10(60)))
    steps = [step for step in (1.0, 2.0, 5.0, 10.0) if step * speed < 100]
    step = float(rng.choice(steps[-2:]))
    span = ORBIT_S if whole else float(10 ** rng.uniform(np.log10(76), np.log10(2500)))
    names = tuple(rng.permutation(list(FACES))[: rng.integers(1, 6)].tolist())
    turned = np.eye(3, dtype=int)
    if rng.random() < 1 / 3:
        turned = np.rint(Rotation.create_group("O").as_matrix()[rng.integers(1, 24)]).astype(int)
    zero = 10 ** rng.uniform(np.log10(0.3), np.log10(5)) * unit(rng)
    return Case(
        seed,
        number,
        float(speed * rng.choice([-1, 1])),
        int(rng.integers(3)),
        float(rng.uniform(0, 1.5)),
        names,
        tuple(map(tuple, turned.tolist())),
        tuple(zero.tolist()),
        bool(rng.random() < 0.7),
        float(rng.uniform(0.3, 1.9)),
        bool(rng.random() < 0.85),
        float(rng.uniform(0.1, 0.3)),
        step,
        max(76, int(span / step)),
    )


def unit(rng: np.random.Generator) -> np.ndarray:
    """Draw a direction (3), uniform on the sphere."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


class Sky(NamedTuple):
    """Surroundings at n instants, in true equator and equinox of date: `place_km`, `field_nT` and `sun` (n, 3), `lit` (n)."""

    place_km: np.ndarray
    field_nT: np.ndarray
    sun: np.ndarray
    lit: np.ndarray


def draw_elements(rng: np.random.Generator, start: datetime) -> tuple[str, str]:
    """Draw the two lines of a low orbit, with an epoch up to three days before the start."""
    inclination, node, perigee, anomaly = rng.uniform([40, 0, 0, 0], [99, 360, 360, 360])
    epoch = start - timedelta(days=float(rng.uniform(0, 3)))
    day = (epoch - datetime(epoch.year, 1, 1)).total_seconds() / 86400 + 1
    first = (
        f"1 99999U 25001A   {epoch.year % 100:02d}{day:012.8f}  .00001000  00000-0  50000-4 0  999"
    )
    shape = f"{int(rng.uniform(2e3, 2e4)):07d} {perigee:8.4f} {anomaly:8.4f} {rng.uniform(15.0, 15.6):11.8f}"
    second = f"2 99999 {inclination:8.4f} {node:8.4f} {shape}    1"
    return with_check_digit(first), with_check_digit(second)


def along_orbit(
    two_lines: tuple[str, str], start: datetime, t_s: np.ndarray, ahead_s: float
) -> Sky:
    """Return the surroundings at times (n) in s after the start, for a satellite `ahead_s` ahead of its elements."""
    knots = np.arange(-20.0, t_s[-1] + 40.0, 10.0)
    day, fraction = jday(start.year, start.month, start.day, start.hour, start.minute, start.second)
    error, place, _ = Satrec.twoline2rv(*two_lines).sgp4_array(
        np.full(len(knots), day), fraction + (knots + ahead_s) / 86400
    )
    if error.any():
        raise ValueError("SGP4 does not propagate these elements")
    sidereal = erfa.gmst82(day, fraction + knots / 86400)
    radius = np.linalg.norm(place, axis=1)
    theta, phi = np.arccos(place[:, 2] / radius), np.arctan2(place[:, 1], place[:, 0])
    up, south, east = (
        part[0]
        for part in ppigrf.igrf_gc(radius, np.degrees(theta), np.degrees(phi - sidereal), start)
    )
    level = up * np.sin(theta) + south * np.cos(theta)
    field = np.column_stack(
        [
            level * np.cos(phi) - east * np.sin(phi),
            level * np.sin(phi) + east * np.cos(phi),
            up * np.cos(theta) - south * np.sin(theta),
        ]
    )
    earth = erfa.epv00(day, fraction)[0]["p"]
    sun = erfa.pnm06a(day, fraction) @ -earth
    sun = np.tile(sun / np.linalg.norm(sun), (len(t_s), 1))
    place_at = CubicSpline(knots, place)(t_s)
    along = (place_at * sun).sum(axis=1)
    lit = (along > 0) | (np.linalg.norm(place_at - along[:, None] * sun, axis=1) > EARTH_KM)
    return Sky(place_at, CubicSpline(knots, field)(t_s), sun, lit)


def spin(case: Case, t_s: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return rates (n, 3) in rad/s in body axes and attitudes (n, 3, 3) from space to body, for a body symmetric about its spin
    axis.

    The body rotates evenly about its momentum, and about its axis at the difference of both rates. A torque along the momentum
    stretches the time.
    """
    ratio, nutation = case.moments, np.radians(case.nutation_deg)
    faster = float(rng.uniform(-0.01, 0.01)) / ORBIT_S
    tau, stretched = t_s + faster * t_s**2 / 2, 1 + faster * t_s
    spin_rate = np.radians(case.spin_deg_s)
    # about the axis w3; momentum over the moment across, L/It = w3 ratio / cos(nutation); the body's own turn w3 (1 - ratio)
    about_momentum, about_axis = spin_rate * ratio / np.cos(nutation), spin_rate * (1 - ratio)
    begin = rng.uniform(0, 2 * np.pi)
    own = Rotation.from_rotvec(np.outer(-(begin + about_axis * tau), [0, 0, 1]))
    tilt = Rotation.from_rotvec([nutation, 0, 0])
    momentum = Rotation.from_rotvec(np.outer(-about_momentum * tau, [0, 0, 1]))
    across = spin_rate * ratio * np.tan(nutation)  # L/It sin(nutation)
    rates = (own * tilt).apply([0, 0, about_momentum])
    rates = (rates + [0, 0, about_axis]) * stretched[:, None]
    assert np.allclose(
        np.linalg.norm(rates[:, :2], axis=1), abs(across) * stretched, rtol=1e-9, atol=0
    )
    # the spin so far is about z; the axes are permuted so that it is about the axis of the case
    permuted = np.roll(np.eye(3), case.axis - 2, axis=0)
    body = (
        own * tilt * momentum * Rotation.random(random_state=int(rng.integers(2**31)))
    ).as_matrix()
    return rates @ permuted.T, permuted @ body


def earth_light(sky: Sky, body: np.ndarray, normals: np.ndarray, albedo: float) -> np.ndarray:
    """Return the light of the Earth on panels (n, p), in full Suns; a panel over sunlit ground gets about `albedo`.

    `body` (n, 3, 3): attitudes from space to body; `normals` (p, 3) in the body. The visible ground is divided into `rings` about
    the point below, and each ring into `around` patches, which reflect sunlight by Lambert's law.
    """
    rings, around = 8, 16
    light = np.zeros((len(body), len(normals)))
    for k, (place, sun) in enumerate(zip(sky.place_km, sky.sun, strict=True)):
        radius = np.linalg.norm(place)
        up = place / radius
        # angles at the centre of the Earth: to the horizon, and to the middle of each ring
        edge = np.arccos(EARTH_KM / radius)
        psi = edge * (np.arange(rings) + 0.5) / rings
        side = np.cross(up, [0.3, 0.5, 0.8])
        side /= np.linalg.norm(side)
        azimuth = 2 * np.pi * np.arange(around) / around
        level = np.cos(azimuth)[:, None] * side + np.sin(azimuth)[:, None] * np.cross(up, side)
        # unit vectors from the centre of the Earth to the patches, and their areas in km2
        ground = (np.cos(psi)[:, None, None] * up + np.sin(psi)[:, None, None] * level).reshape(
            -1, 3
        )
        ring = np.cos(psi - edge / rings / 2) - np.cos(psi + edge / rings / 2)
        area = np.repeat(2 * np.pi / around * EARTH_KM**2 * ring, around)
        ray = EARTH_KM * ground - place
        distance = np.linalg.norm(ray, axis=1)
        ray /= distance[:, None]
        sent = (
            np.maximum(ground @ sun, 0)
            * np.maximum(-(ray * ground).sum(axis=1), 0)
            * area
            / distance**2
            / np.pi
        )
        light[k] = np.maximum(normals @ (body[k] @ ray.T), 0) @ sent
    # light of a Lambert sphere of albedo one on a panel that faces its sunlit middle
    full = (EARTH_KM / np.linalg.norm(sky.place_km, axis=1).mean()) ** 2
    return albedo / full * light


def make(case: Case, folder: Path) -> dict[str, Any]:
    """Write `vehicle.toml`, `telemetry.csv`, `right.tle` and `wrong.tle`, and return the truth.

    Keys: `t_s`, `rates_deg_s` (n, 3), `lit`, and `matrix` and `zero_nT` of the magnetometer, whose reading is matrix field + zero.
    Orbit and motion are drawn again until some panel sees the Sun for more than `SEEN` of the day, and a file over an orbit has a
    night, a shorter one almost none.
    """
    rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=(case.number, 1)))
    start = datetime(2026, 1, 1) + timedelta(days=float(np.round(rng.uniform(0, 200), 2)))
    start = start.replace(microsecond=0)
    t_s = case.step_s * np.arange(case.samples)
    ahead_s = float(rng.normal(0, 1.0))
    normals = np.array([FACES[name] for name in case.faces], dtype=float)
    while True:
        two_lines = draw_elements(rng, start)
        sky = along_orbit(two_lines, start, t_s, ahead_s)
        rates, body = spin(case, t_s, rng)
        sun_B, field_B = (np.einsum("nij,nj->ni", body, part) for part in (sky.sun, sky.field_nT))
        direct = np.maximum(sun_B @ normals.T, 0) * sky.lit[:, None]
        has_right_night = sky.lit.mean() < 0.8 if case.whole_orbit else sky.lit.mean() > 0.9
        if has_right_night and ((direct > 0.3).any(axis=1)[sky.lit]).mean() > SEEN:
            break
    light = direct + earth_light(sky, body, normals, case.albedo)
    gain = np.exp(0.02 * rng.normal(size=len(normals)))
    current = GAIN_A * (gain * light + SUN_NOISE * rng.normal(size=light.shape))
    # magnetometer: soft iron and unequal scales, zero, noise, and then the permutation of its axes
    distortion = np.eye(3) + 0.03 * rng.normal(size=(3, 3)) + np.diag(0.03 * rng.normal(size=3))
    zero = USUAL_NT * np.array(case.zero)
    distorted = field_B @ distortion.T + zero + FIELD_NOISE_NT * rng.normal(size=field_B.shape)
    reading = distorted @ np.array(case.turned, dtype=float).T
    folder.mkdir(parents=True, exist_ok=True)
    header = ",".join(["time", *(f"i{name}" for name in case.faces), "mx", "my", "mz"])
    rows = [
        f"{(start + timedelta(seconds=t)).isoformat(timespec='milliseconds')}Z,"
        + ",".join(f"{value:.5f}" for value in currents)
        + ","
        + ",".join(f"{value:.0f}" for value in fields)
        for t, currents, fields in zip(t_s.tolist(), current, reading, strict=True)
    ]
    (folder / "telemetry.csv").write_text("\n".join([header, *rows]) + "\n", "utf-8")
    stated = (
        np.array(case.turned) @ zero + ZERO_OFF * USUAL_NT * rng.normal(size=3)
        if case.zero_known
        else np.zeros(3)
    )
    zero_sigma_nT = USUAL_NT * (ZERO_OFF if case.zero_known else ZERO_OPEN)
    (folder / "vehicle.toml").write_text(_vehicle(case, stated, zero_sigma_nT), "utf-8")
    for name, by_deg in (
        ("right", 0.0),
        ("wrong", WRONG_NODE_DEG if rng.random() < 0.5 else -WRONG_NODE_DEG),
    ):
        (folder / f"{name}.tle").write_text(
            f"SPINNER\n{two_lines[0]}\n{with_node_turned(two_lines[1], by_deg)}\n", "utf-8"
        )
    return {
        "t_s": t_s.tolist(),
        "rates_deg_s": np.degrees(rates).tolist(),
        "lit": float(sky.lit.mean()),
        "matrix": (np.array(case.turned) @ distortion).tolist(),
        "zero_nT": (np.array(case.turned) @ zero).tolist(),
    }


def _vehicle(case: Case, zero_nT: np.ndarray, zero_sigma_nT: float) -> str:
    """Return the text of the vehicle file, with this zero (3) of the magnetometer and its sigma."""
    lines = ['name = "spinner"']
    if case.inertia_known:
        moments = np.full(3, 0.03)
        moments[case.axis] *= case.moments
        lines += [
            "[body]",
            f"inertia_kg_m2 = {{ value = {np.round(np.diag(moments), 5).tolist()}, sigma = 0.001 }}",
        ]
    for name in case.faces:
        lines += [
            "[[panel]]",
            f'name = "{name}"',
            f"normal_B = {list(FACES[name])}",
            f"gain_A = {GAIN_A}",
        ]
    lines += [
        "[telemetry]",
        'quantity = "current_A"',
        'time_column = "time"',
        f"noise = {SUN_NOISE * GAIN_A}",
    ]
    lines += ["[telemetry.columns]"]
    lines += [f'"{name}" = "i{name}"' for name in case.faces]
    zero = ", ".join(f"{x:.0f}" for x in zero_nT)
    lines += [
        "[magnetometer]",
        'columns = ["mx", "my", "mz"]',
        f"noise = {FIELD_NOISE_NT}",
        "scale_T = 1e-9",
        f"zero = {{ value = [{zero}], sigma = {zero_sigma_nT:.0f} }}",
        "[disturbance]",
        "max_rate_rad_s = 1.2",
    ]
    return "\n".join(lines) + "\n"


def run(case: Case, folder: Path, what: str) -> dict[str, Any]:
    """Check the elements of a case, or estimate its rates, and return the result as a row.

    `what` is "check" or "rates", a space, and the elements: "right", "wrong" or "none". The row has "defect", whether the command
    `check` ended with a traceback; for a failed run "error"; else "orbit", the verdict on the elements, or for `rates` "passes".
    """
    command, which = what.split()
    truth = make(case, folder)
    if command == "rates":
        return _estimate(folder, which, truth)
    arguments = [str(folder / "vehicle.toml"), str(folder / "telemetry.csv"), "--json"]
    arguments += [] if which == "none" else ["--tle", str(folder / f"{which}.tle")]
    done = CliRunner().invoke(check, arguments)
    if done.exit_code:
        defect = done.exception is not None and not isinstance(done.exception, SystemExit)
        return {"defect": defect, "error": (done.stderr or repr(done.exception))[-300:]}
    summary = json.loads(done.stdout)
    return {"defect": False} | ({"orbit": summary["orbit"]} if "orbit" in summary else {})


def check_elements(case: Case, folder: Path, which: str) -> dict[str, Any]:
    """Compare "right" or "wrong" elements with the telemetry of a case, by the package that is judged; a row as :func:`run`'s."""
    make(case, folder)
    vehicle = ss.load_vehicle(folder / "vehicle.toml")
    telemetry = ss.read_telemetry(folder / "telemetry.csv", vehicle)
    orbit = orbit_of(vehicle, telemetry, folder / f"{which}.tle")
    found = check_orbit(orbit, vehicle, telemetry)
    shift = {"shift_s": found.shift_s, "shift_sigma_s": found.shift_sigma_s}
    return {"defect": False, "orbit": {"verdict": found.verdict.name.lower()} | shift}


def _estimate(folder: Path, which: str, truth: dict[str, Any]) -> dict[str, Any]:
    """Return the row of `rates` on the files of a case; elements that do not fit the telemetry are not used."""
    craft = ss.load_vehicle(folder / "vehicle.toml")
    assessment = assess(craft, ss.read_telemetry(folder / "telemetry.csv", craft))
    orbit = calibration = None
    try:
        if which != "none":
            chosen = choose_orbit(assessment, OrbitFile(folder / f"{which}.tle"), None)
            orbit, calibration = chosen.orbit, chosen.calibration
        result = ss.rates(craft, assessment, environment=orbit, calibration=calibration)
    except SunspinError as error:
        return {"defect": False, "error": str(error)[-300:]}
    passes = [_pass(truth, result.isel(pass_id=k)) for k in range(result.sizes["pass_id"])]
    return {"defect": False, "passes": passes}


def _pass(truth: dict[str, Any], result: xr.Dataset) -> dict[str, Any]:
    """Return the comparison of a pass (a result on one `pass_id`) with the truth at the sample nearest to its middle; deg/s."""
    t_s = result["time"].values[result["pass_of"].values == int(result["pass_id"])]
    at_s = t_s[np.argmin(np.abs(t_s - (t_s[0] + t_s[-1]) / 2))]
    true = np.array(truth["rates_deg_s"])[np.abs(np.array(truth["t_s"]) - at_s).argmin()]
    listed = np.isfinite(result["probability"].values)
    omega, sigma = (
        np.stack([result[f"{name}_{axis}"].values[listed] for axis in "xyz"], axis=1)
        for name in ("omega", "sigma")
    )
    probability = result["probability"].values[listed]
    return {
        "decided": bool(result["decided"]),
        "off_all": (np.degrees(omega[0]) - true).tolist(),
        "sigma_all": np.degrees(sigma[0]).tolist(),
        "wrong": is_wrong(omega[0], sigma[0], np.radians(true)),
        "listed": is_listed(omega, sigma, probability, np.radians(true)),
    }
