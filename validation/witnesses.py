"""Comparisons with other sources of the same physics: closed forms, published values, other integrators and transport solvers.

Each witness is a function that yields rows: what is compared, the relative difference, and the largest one allowed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipkinc
from scipy.stats import wasserstein_distance

import sunspin as ss
from sunspin.dynamics.batch import Rows, run
from sunspin.vehicle import Friction, Vehicle, Wheel

BASILISK_MRP = (0.373034285, -0.00239564413, 0.208570797)
"""Attitude after 10 s, from the unit test of Basilisk's spacecraft module: diag(500, 200, 300) kg m2, (0.5, -0.4, 0.7) rad/s."""

SUN = np.array([0.36, 0.48, 0.8])


class Row(NamedTuple):
    """One comparison: `error` is the largest difference, as a part of the size of the quantity; `wanted` the largest allowed."""

    witness: str
    what: str
    error: float
    wanted: float

    @property
    def digits(self) -> float:
        """Decimal digits that agree, 16 at most."""
        return float(min(16.0, -np.log10(max(self.error, 1e-16))))

    @property
    def holds(self) -> bool:
        """True if the difference is small enough."""
        return self.error <= self.wanted


def basilisk() -> Iterator[Row]:
    """Compare the attitude of a free rigid body with a published value of Basilisk."""
    hub = Vehicle("hub", np.diag([500.0, 200.0, 300.0]))
    motion = ss.propagate(hub, [0.5, -0.4, 0.7], [1, 0, 0], None, [0.0, 10.0])
    # Basilisk's parameters are of the rotation that takes the reference axes to the body axes
    mrp = Rotation.from_quat(motion["B_from_N"].values[-1]).inv().as_mrp()
    error = float(np.abs(mrp - BASILISK_MRP).max())
    yield Row("Basilisk, published", "attitude (MRP) after 10 s", error, 5e-10)


def free_rigid_body() -> Iterator[Row]:
    """Compare Euler's case with Jacobi's functions: both kinds of motion, 200 revolutions, with phase (Landau and Lifshitz 1,
    section 37).
    """
    moments = np.array([0.7, 1.0, 1.6])  # increasing
    t = np.linspace(0, 1300.0, 400)
    for name, omega in (
        ("about the short axis", (0.2, 0.3, 1.0)),
        ("about the long axis", (1.0, 0.3, 0.1)),
    ):
        expected = euler(moments, np.array(omega), t)
        motion = ss.propagate(Vehicle("free", np.diag(moments)), omega, SUN, None, t)
        error = np.abs(motion["omega_B"].values - expected).max() / np.linalg.norm(omega)
        what = f"free body {name}, rates with phase, 1300 s"
        yield Row("Jacobi's elliptic functions (SciPy)", what, float(error), 1e-10)
        # a body of a hundred times the inertia moves in the same way
        larger = Vehicle("free", 100.0 * np.diag(moments))
        rows = Rows(np.array([omega], dtype=float), SUN[None], np.zeros((1, 0)))
        rates = run(larger, rows, t[1:], error=1e-9).omega_B[0]
        error = np.abs(rates - expected[1:]).max() / np.linalg.norm(omega)
        what = f"the ensemble kernel, the same {name}"
        yield Row("Jacobi's elliptic functions (SciPy)", what, float(error), 1e-8)


def euler(moments: np.ndarray, omega: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return rates (n, 3) of a free body with increasing principal moments, from `omega` at t = 0.

    The body rotates about its third axis if L^2 > 2 E I2, else about its first one (L angular momentum, E energy).
    """
    square, twice_energy = (moments * omega) @ (moments * omega), moments @ omega**2
    if square < moments[1] * twice_energy:
        # the same formulas with the axes in reverse order, which needs a sign to stay right-handed
        return _polhode(moments[::-1], omega[::-1] * [1, -1, 1], t)[:, ::-1] * [1, -1, 1]
    return _polhode(moments, omega, t)


def _polhode(moments: np.ndarray, omega: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the rates (n, 3) of a motion about the third axis, whose moment is the largest or the smallest.

    Landau and Lifshitz 1, section 37, equations 37.10 to 37.12, with the phase at t = 0.
    """
    I1, I2, I3 = moments
    twice_energy, square = moments @ omega**2, (moments * omega) @ (moments * omega)  # 2 E, L^2
    from_third, from_first = twice_energy * I3 - square, square - twice_energy * I1
    amplitude = np.sqrt(
        [
            from_third / (I1 * (I3 - I1)),
            from_third / (I2 * (I3 - I2)),
            from_first / (I3 * (I3 - I1)),
        ]
    )
    rate = np.sign(I3 - I1) * np.sqrt((I3 - I2) * from_first / (I1 * I2 * I3))
    m = (I2 - I1) * from_third / ((I3 - I2) * from_first)  # parameter of the elliptic functions
    sense = np.sign(omega[2])
    phase = ellipkinc(np.arctan2(sense * omega[1] / amplitude[1], omega[0] / amplitude[0]), m)
    sn, cn, dn, _ = ellipj(rate * t + phase, m)
    return np.stack(
        [amplitude[0] * cn, sense * amplitude[1] * sn, sense * amplitude[2] * dn], axis=1
    )


def gyrostat() -> Iterator[Row]:
    """Compare an axisymmetric body with a coasting wheel on its axis with its closed form, through the wheel's stop."""
    moment, axial, inertia, begin = 13.0, 16.5, 0.0058, 865.0
    friction = Friction(1e-3, 2.7e-6)
    vehicle = Vehicle(
        "axisymmetric",
        np.diag([moment, moment, axial]),
        wheels=[Wheel("w", [0, 0, 1], inertia, begin, friction)],
    )
    omega = np.array([-0.2, 0.1, 0.05])
    t = np.linspace(0, 3600.0, 241)
    motion = ss.propagate(vehicle, omega, SUN, begin, t)
    H = np.array([moment, moment, axial]) * omega + [0, 0, inertia * begin]
    # in space H is fixed, and the symmetry axis rotates about it
    rotation = Rotation.from_rotvec(H / moment * t[:, None])
    z_N = rotation.apply([0.0, 0.0, 1.0])
    error = float(np.abs(motion["sun_B"].values[:, 2] - z_N @ SUN).max())
    yield Row("closed form", "axisymmetric gyrostat, Sun's height with phase, 1 h", error, 1e-9)
    # axial rate: the wheel's speed relative to the body obeys J' dW/dt = -mu0 - mu1 W, J' = J (1 - J / axial)
    reduced = inertia * (1 - inertia / axial)
    tau, ratio = reduced / friction.viscous_N_m_s, friction.coulomb_N_m / friction.viscous_N_m_s
    speed = np.maximum((begin + ratio) * np.exp(-t / tau) - ratio, 0.0)
    error = float(np.abs(motion["wheel_speed_rad_s"].values[:, 0] - speed).max() / begin)
    yield Row("closed form", "wheel spin-down on a free body, 1 h", error, 1e-10)
    stop = tau * np.log1p(begin / ratio)
    error = float(abs(motion["event_time_s"].values[0] - stop) / stop)
    yield Row("closed form", "instant at which the wheel stops", error, 1e-11)
    axial_rate = omega[2] + inertia * (begin - speed) / axial
    error = float(np.abs(motion["omega_B"].values[:, 2] - axial_rate).max() / 0.3)
    yield Row("closed form", "axial rate of the body meanwhile", error, 1e-10)


def paper_equations() -> Iterator[Row]:
    """Compare SciPy's DOP853 on the paper's eqs. (3), (4), (5), (7) as printed: Philae through the wheel's stop."""
    theta = np.array([[13.905, -0.352, -0.015], [-0.352, 12.603, 0.007], [-0.015, 0.007, 16.523]])
    axis, J = np.array([0, 0, 1.0]), 0.0058
    friction = Friction.from_spin_down(1271.0, -4.643e-4, -388.9, J)
    inverse = np.linalg.inv(theta - J * np.outer(axis, axis))

    def slipping(_t: float, y: np.ndarray) -> np.ndarray:
        """Return the derivative of (omega, W, r) while the wheel turns."""
        omega, W, r = y[:3], y[3], y[4:]
        torque = -np.sign(W) * (friction.coulomb_N_m + friction.viscous_N_m_s * abs(W))
        rate = -inverse @ (
            np.cross(omega, theta @ omega) + axis * torque + np.cross(omega, J * axis * W)
        )
        return np.concatenate([rate, [torque / J - axis @ rate], -np.cross(omega, r)])

    def stuck(_t: float, y: np.ndarray) -> np.ndarray:
        """Return the derivative of (omega, W, r) after the wheel has stopped."""
        rate = -np.linalg.solve(theta, np.cross(y[:3], theta @ y[:3]))
        return np.concatenate([rate, [0.0], -np.cross(y[:3], y[4:])])

    def stops(_t: float, y: np.ndarray) -> float:
        """Return the wheel speed, whose zero is the stop."""
        return y[3]

    stops.terminal = True  # type: ignore[attr-defined]
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
    omega = [-0.1, 0.2, 0.0]
    first = solve_ivp(slipping, (0, 2700), [*omega, 865.0, *SUN], events=stops, **options)
    second = solve_ivp(
        stuck, (first.t[-1], 2700), [*first.y[:3, -1], 0.0, *first.y[4:, -1]], **options
    )
    vehicle = Vehicle("philae", theta, 97.63, wheels=[Wheel("w", axis, J, 865.0, friction)])
    motion = ss.propagate(vehicle, omega, SUN, 865.0, [0.0, 2700.0])
    error = float(abs(motion["event_time_s"].values[0] / first.t[-1] - 1))
    yield Row("DOP853 (SciPy), paper's equations", "instant of the stop", error, 1e-11)
    error = float(np.abs(motion["sun_B"].values[-1] - second.y[4:, -1]).max())
    yield Row("DOP853 (SciPy), paper's equations", "Sun after 45 min", error, 1e-8)
    last = second.y[:3, -1]
    rate = np.abs(motion["omega_B"].values[-1] - last).max() / np.linalg.norm(last)
    yield Row("DOP853 (SciPy), paper's equations", "rates after 45 min", float(rate), 1e-8)


def transport() -> Iterator[Row]:
    """Compare EMD with other solvers of the same transport problem (`sunspin.emd` itself is SciPy's), and that of a scan with
    SciPy's.
    """
    rng = np.random.default_rng(0)
    worst = {"linprog": 0.0, "pot": 0.0, "sorted": 0.0}
    for n, m in ((5, 9), (15, 40), (30, 11)):
        (a, wa), (b, wb) = (
            (rng.uniform(-1, 1, size), rng.uniform(0.1, 1, size)) for size in (n, m)
        )
        ours = ss.emd(a, b, wa, wb)
        worst["linprog"] = max(
            worst["linprog"], abs(ours - _cheapest(a, b, wa / wa.sum(), wb / wb.sum()))
        )
        if (pot := _pot(a, b, wa, wb)) is not None:
            worst["pot"] = max(worst["pot"], abs(ours - pot))
        x, y = rng.uniform(-1, 1, (2, n))
        worst["sorted"] = max(
            worst["sorted"], abs(ss.emd(x, y) - np.abs(np.sort(x) - np.sort(y)).mean() / 2)
        )
    yield Row("linear programme (HiGHS)", "EMD as the cheapest transport", worst["linprog"], 1e-9)
    if _pot(a, b, wa, wb) is not None:
        yield Row("POT, emd2_1d", "EMD, weighted samples", worst["pot"], 1e-14)
    yield Row("closed form", "EMD of equal numbers: sorted differences", worst["sorted"], 1e-14)
    vehicle, target = Vehicle("free", np.diag([0.7, 1.0, 1.6])), rng.uniform(-1, 1, 20)
    omega = np.array([0.2, 0.3, 0.6])
    ours = ss.scan(vehicle, target, SUN, *omega[:, None], None, 900.0, mask=None).item()
    track = ss.propagate(vehicle, omega, SUN, None, np.linspace(0, 900, 90_001), rtol=1e-9)[
        "sun_B"
    ].values[:, 2]
    error = abs(ours - wasserstein_distance(track, target) / 2)
    what = "EMD of a scan, of a sampled track of the reference"
    yield Row("SciPy, wasserstein_distance", what, error, 1e-3)


def _cheapest(a: np.ndarray, b: np.ndarray, wa: np.ndarray, wb: np.ndarray) -> float:
    """Return the EMD of samples a (n) and b (m) with weights of sum one, as the solution of a linear programme.

    Its unknowns are the shares (n m) that move from each a to each b; all of each weight leaves and arrives.
    """
    leaves = np.kron(np.eye(len(a)), np.ones(len(b)))
    arrives = np.kron(np.ones(len(a)), np.eye(len(b)))
    cost, shares = np.abs(a[:, None] - b).ravel() / 2, np.concatenate([wa, wb])
    return float(linprog(cost, A_eq=np.vstack([leaves, arrives]), b_eq=shares).fun)


def _pot(a: np.ndarray, b: np.ndarray, wa: np.ndarray, wb: np.ndarray) -> float | None:
    """Return the EMD by POT; None if it is not installed."""
    try:
        import ot
    except ImportError:
        return None
    return float(ot.emd2_1d(a, b, wa / wa.sum(), wb / wb.sum(), metric="euclidean")) / 2


def return_trips() -> Iterator[Row]:
    """Compare a state with itself after propagation forth and back through the wheel's stop, by the reference and by the kernel."""
    friction = Friction.from_spin_down(1271.0, -4.643e-4, -388.9, 0.0058)
    theta = [[13.905, -0.352, -0.015], [-0.352, 12.603, 0.007], [-0.015, 0.007, 16.523]]
    vehicle = Vehicle("philae", theta, wheels=[Wheel("w", [0, 0, 1], 0.0058, 865.0, friction)])
    omega = np.array([-0.2, 0.05, 0.02])
    forth = ss.propagate(vehicle, omega, SUN, 865.0, [0.0, 2700.0])
    end = forth.isel(time=-1)
    back = ss.propagate(
        vehicle,
        end["omega_B"],
        end["sun_B"],
        0.0,
        [2700.0, 0.0],
        stopped_at_s=float(forth["event_time_s"][0]),
    )
    error = float(np.abs(back["sun_B"].values[-1] - SUN).max())
    yield Row("itself, backward", "Sun after 45 min there and back, through the stop", error, 1e-9)
    rows = Rows(omega[None], SUN[None], np.array([[865.0]]))
    far = run(vehicle, rows, 2000.0, error=1e-9)
    final = Rows(far.omega_B[:, 0], far.sun_B[:, 0], far.wheel_speed_rad_s[:, 0])
    home = run(vehicle, final, -2000.0, error=1e-9)
    error = float(np.abs(home.sun_B[0, 0] - SUN).max())
    yield Row("itself, backward", "the ensemble kernel, 2000 s there and back", error, 1e-8)


WITNESSES = (basilisk, free_rigid_body, gyrostat, paper_equations, transport, return_trips)


def table(rows: list[Row]) -> str:
    """Return the comparisons as a table in Markdown."""
    lines = ["| witness | what | difference | digits |", "|---|---|---|---|"]
    return "\n".join(
        lines + [f"| {r.witness} | {r.what} | {r.error:.1e} | {r.digits:.1f} |" for r in rows]
    )


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this campaign."""
    parser.add_argument("--only", choices=[witness.__name__ for witness in WITNESSES])


def main(given: argparse.Namespace) -> int:
    """Print the table; return 1 if any witness does not agree."""
    chosen = [witness for witness in WITNESSES if given.only in (None, witness.__name__)]
    rows = [row for witness in chosen for row in witness()]
    print(table(rows))
    failed = [row for row in rows if not row.holds]
    for row in failed:
        print(f"MISSED: {row.witness}, {row.what}: {row.error:.2e}, wanted {row.wanted:.0e}")
    return int(bool(failed))
