"""The verdict on the estimate of a pass: four checks, the table of passes, and the words that report them.

Is one solution left (unique)? Do the data constrain all rate components? Does each sensor fit by itself? Was the search complete? A
pass is decided if all four are met. The constants here set the error rates of the verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.special import chdtri, ndtr  # scipy.stats takes longer to import than a short pass

from sunspin.environment.frames import FIELD_Z_LOCAL
from sunspin.estimate.model import AS_STATED
from sunspin.estimate.settings import LARGEST_TURNS, SearchSettings
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import utc_after

DECIDED = 0.9
"""A solution is unique if it has at least this probability."""

NARROWER = 0.5
"""A component is constrained if its standard deviation over all solutions is below this part of the prior's."""

BEYOND = 2 * float(ndtr(-3.0))
"""Probability that a reading with the stated noise is off by more than three sigma."""

MOST_BEYOND, ONE_SPIKE = 0.3, 1.5
"""A sensor does not fit if more than this share of its readings, and more than one, is off by more than three sigma."""

FEW_BEYOND, LEAST_BEYOND = 0.04, 4
"""A sensor does not fit either if more than this share of its readings, and at least so many, is off by more than three sigma in
runs: single outliers are spread over the pass, but a wrong motion is off for a while."""

IN_RUNS = 1e-2
"""Readings beyond three sigma lie in runs if randomly spread ones would form so few runs with less than this probability."""

COLUMNS_STATED, COLUMNS_UNCHECKED, COLUMNS_DOUBTED = "as_stated", "unchecked", "doubtful"
"""Whether the data confirm which column is which: they do; they cannot; another order, sign or axis fits better."""

SPEEDS = (0.05, 0.5, 0.95)
"""Quantiles of the angular speed that are reported."""

DRAWS = 10_000
"""Draws from which these are computed: the 95 % quantile of one normal number is then known to 2 % of its sigma."""

UPPER = 0.95
"""Probability of an upper limit of the speed."""

WHEEL_LACKS = "torques too strong for a satellite: if a wheel turns, state it with its speed; else check the inertia"
"""Why a body with a stated inertia and without wheels is not decided from Sun directions alone, and what to do."""

WHEEL_CHANGES = "the rate changes in steps, and a wheel may have changed its speed: give its speed_column, or cut the pass there"
"""Why a body whose rate has several steps is not decided if no column gives the speed of a wheel, and what to do."""

SELDOM_FASTER_DEG_S = 30.0
"""A largest rate that is assumed is printed if it is less than this: few satellites turn faster."""

SUN_ALONE = "only Sun directions were used: rotation about the Sun direction is constrained only by the dynamics"

FIELD_ALONE = (
    "magnetometer only, NO ORBIT: rates are relative to the field direction (itself rotating by about 0.1 deg/s, included in the "
    "errors); inertial attitude and Sun direction are not available"
)

OTHER_SENSORS = ("gyro", "field", "attitude")
"""Sensors other than the Sun's; the attributes say which were used."""


class Misfit(NamedTuple):
    """How well one sensor fits the best motion.

    `count`: number of readings; `share`: part of them that is off by more than three sigma; `chance`: probability of so few runs of
    such readings and others over time if they were spread at random.
    """

    count: int
    share: float
    chance: float

    @property
    def fits(self) -> bool:
        """Return whether the sensor agrees with the motion."""
        # an integer up to rounding, so that it is compared with half-integers
        beyond = self.share * self.count
        in_runs = self.share > FEW_BEYOND and beyond > LEAST_BEYOND - 0.5 and self.chance < IN_RUNS
        return not (in_runs or (self.share > MOST_BEYOND and beyond > ONE_SPIKE))


def in_sigma(square: np.ndarray, freedom: np.ndarray | int) -> np.ndarray:
    """Return the sizes (...) in sigmas of residuals with several components, from their sums of squares (...).

    `freedom`: number of independent components of each. A size is the root of the sum, scaled so that it exceeds 3 as often as the
    size of one normal number does (:data:`BEYOND`).
    """
    return 3 * np.sqrt(np.maximum(square, 0.0) / chdtri(np.maximum(freedom, 1), BEYOND))


def misfit(sigmas: np.ndarray) -> Misfit:
    """Return the misfit of one sensor from its residuals (n) in the order of time: sizes by :func:`in_sigma`, NaN without a
    reading.

    A residual beyond three sigma is bad. A run is a stretch of residuals that are all good or all bad. The number of runs is
    compared with its mean and variance for a random order (Wald and Wolfowitz 1940, Ann. Math. Statist. 11, 147).
    """
    is_bad = np.asarray(sigmas)[np.isfinite(sigmas)] > 3.0
    n, bad = len(is_bad), int(is_bad.sum())
    good = n - bad
    if not bad or not good:
        return Misfit(n, bad / max(n, 1), 1.0)
    runs = 1 + int(np.count_nonzero(is_bad[1:] != is_bad[:-1]))
    expected = 1 + 2 * bad * good / n
    variance = (expected - 1) * (expected - 2) / max(n - 1, 1)
    chance = ndtr((runs - expected) / np.sqrt(variance)) if variance > 0 else 1.0
    return Misfit(n, bad / n, float(chance))


class Speed(NamedTuple):
    """The angular speed of a pass at one instant, rad/s.

    `value`: of the most probable solution; `sigma`: root mean square difference from it within that solution; `below`: 95 %
    quantile over all solutions.
    """

    value: float
    sigma: float
    below: float

    @property
    def constrained(self) -> bool:
        """Return whether the speed is larger than its error; else the data give only an upper limit, `below`."""
        return bool(self.sigma <= self.value)

    @property
    def limit(self) -> str:
        """Return the upper limit in words, in deg/s with two significant digits."""
        return f"speed below {upper_text(np.degrees(self.below))} deg/s (95 %)"


def upper_text(value: float) -> str:
    """Return a positive number with two significant digits, rounded up, without an exponent: 0.053, 8.4, 120."""
    if not np.isfinite(value) or value <= 0:
        return f"{value:g}"
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    # a limit rounded down would not hold; 1e-9 keeps 0.050 from becoming 0.051 by rounding errors
    up = np.ceil(value / unit - 1e-9) * unit
    return np.format_float_positional(up, precision=2, fractional=False, trim="-")


def drawn_speeds(omega: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return draws (K, `DRAWS`), from a fixed seed, of the speed of normally distributed rates (K, 3) with covariances (K, 3,
    3)."""
    normal = np.random.default_rng(0).standard_normal((DRAWS, 3))
    values, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]  # root root^T is the covariance
    return np.linalg.norm(omega[:, None] + np.einsum("kij,nj->kni", root, normal), axis=-1)


def speed_of(omega: np.ndarray, drawn: np.ndarray, probability: np.ndarray) -> Speed:
    """Return the angular speed of K solutions: that of the first, with the rate `omega` (3), its error, and a limit for all.

    Near zero the speed is not normally distributed, so that error and limit come from the draws `drawn` (K, `DRAWS`) of the speed.
    The error is that of the first solution: an unlikely alias does not enlarge it. The limit is the quantile :data:`UPPER` over all
    solutions, weighted by their `probability` (K).
    """
    value = float(np.linalg.norm(omega))
    if not (np.isfinite(value) and np.isfinite(drawn).all()):
        return Speed(value, np.nan, np.nan)
    # every draw of a solution has the same part of its probability
    weight = np.repeat(probability / probability.sum() / drawn.shape[1], drawn.shape[1])
    speed = drawn.ravel()
    order = np.argsort(speed)
    quantile = np.searchsorted(np.cumsum(weight[order]), UPPER)
    below = float(speed[order[min(quantile, len(order) - 1)]])
    return Speed(value, float(np.sqrt(np.mean((drawn[0] - value) ** 2))), below)


class Answers(NamedTuple):
    """Results of the four checks of one pass.

    `constrained`: by component of the rate; `wrong`: names of the sensors that do not fit; `left_open`: what the search may have
    left out and what would help, in words.
    """

    unique: bool
    constrained: tuple[bool, bool, bool]
    fits: bool
    search_complete: bool
    wrong: tuple[str, ...]
    left_open: str
    speed: Speed

    @property
    def decided(self) -> bool:
        """Return whether all four checks are met, so that an operator may act on the first solution.

        Other functions withdraw it later: if samples repeat (`with_doubted_repeats`), half of the passes do not fit
        (`with_doubted_passes`), or a symmetric solution is not listed or columns, a sensor or a wheel are in doubt
        (`check_columns`). The command withdraws it if field and Sun of an orbit disagree.
        """
        constrained = all(self.constrained) and self.speed.constrained
        return self.unique and self.fits and constrained and self.search_complete

    @property
    def why_not(self) -> str:
        """Return in words which checks are not met; empty if the pass is decided."""
        known = [axis for axis, is_known in zip("xyz", self.constrained, strict=True) if is_known]
        reasons = []
        if not self.fits:
            reasons.append("POOR FIT" + (f" ({', '.join(self.wrong)})" if self.wrong else ""))
        if not self.unique:
            reasons.append("several solutions")
        if len(known) < 3:
            reasons.append(
                f"constrained: {' '.join(known)} only"
                if known
                else "NOT CONSTRAINED (result equals the prior)"
            )
        # an upper limit is valid only if the model fits, the data constrain the components and no faster motion is missing
        elif not self.speed.constrained and self.fits and self.search_complete:
            reasons.append(self.speed.limit)
        if not self.search_complete:
            reasons.append("search incomplete" + (f" ({self.left_open})" if self.left_open else ""))
        return "; ".join(reasons)


class AtOnce(NamedTuple):
    """Rates of K solutions at one instant, the most probable first.

    `probability` (K); `omega` (K, 3) in rad/s with `covariance` (K, 3, 3); `one_rate` (K): whether each has the rate of the first
    one, from which it then differs in the sign of the Sun direction alone.
    """

    probability: np.ndarray
    omega: np.ndarray
    covariance: np.ndarray
    one_rate: np.ndarray


def answers(
    motions: AtOnce,
    rate_sigma: float,
    misfits: Mapping[str, Misfit],
    explained: bool,
    left_open: str,
    denied: Sequence[str] = (),
) -> tuple[Answers, np.ndarray]:
    """Return the results of the four checks of a pass, and quantiles `SPEEDS` of the speed (K, 3) of its K solutions, rad/s.

    `motions`: the solutions at one instant; the first one is judged. `rate_sigma` (rad/s): prior sigma of a component; `misfits`:
    by sensor. `explained`: the cost of the best motion is at most `Observations.cost_limit`. `left_open`: what the search may have
    left out, in words; empty if nothing. `denied`: sensors that fit only with axes far from those of the file.
    """
    probability, omega, covariance, one_rate = motions
    wrong = tuple(name for name, seen in misfits.items() if name in denied or not seen.fits)
    sigma = spread_of(omega, np.einsum("kii->ki", covariance), probability)
    known_x, known_y, known_z = (sigma < NARROWER * rate_sigma).tolist()  # NaN is not constrained
    drawn = drawn_speeds(omega, covariance)
    four_answers = Answers(
        unique=bool(probability[one_rate].sum() >= DECIDED),
        constrained=(known_x, known_y, known_z),
        fits=bool(explained and not wrong),
        search_complete=not left_open,
        wrong=wrong,
        left_open=left_open,
        speed=speed_of(omega[0], drawn, probability),
    )
    return four_answers, np.quantile(drawn, SPEEDS, axis=1).T


def spread_of(omega: np.ndarray, variance: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Return the root mean square difference (3), rad/s, of the rate from that of the first of K solutions.

    All solutions count by their `probability` (K); `omega` (K, 3) and `variance` (K, 3) are those of each.
    """
    share = (probability / probability.sum())[:, None]
    return np.sqrt((share * (variance + (omega - omega[0]) ** 2)).sum(axis=0))


class PassRow(NamedTuple):
    """Row of the table of passes: number of samples used, times of the first and last one (s), and K solutions at the time `at_s`.

    `omega` and `sigma` (K, 3) in rad/s; `speed` (K, 3): quantiles :data:`SPEEDS` in rad/s; `columns_checked`: one of the
    `COLUMNS_...`.
    """

    samples: int
    first_s: float
    last_s: float
    at_s: float
    probability: np.ndarray
    omega: np.ndarray
    sigma: np.ndarray
    speed: np.ndarray
    answers: Answers
    columns_checked: str


def padded(values: Sequence[np.ndarray]) -> np.ndarray:
    """Return the values (n_solution, ...) of all passes as one array (n_pass, most solutions, ...), NaN if a pass has fewer."""
    out = np.full((len(values), max(map(len, values)), *values[0].shape[1:]), np.nan)
    for row, value in zip(out, values, strict=True):
        row[: len(value)] = value
    return out


def passes_table(rows: Sequence[PassRow], epoch_utc: str | None) -> dict[str, Any]:
    """Return the variables of the table of passes, `passes.csv`, on (`pass_id`, `solution`); NaN if a pass has fewer solutions."""

    def utc(seconds: float) -> str:
        """Return a time in UTC; empty without an epoch."""
        return "" if epoch_utc is None else utc_after(seconds, epoch_utc, 3)

    def flags(values: Sequence[bool]) -> Any:
        """Return a variable of true and false on passes."""
        return "pass_id", np.array(values, dtype=bool)

    verdicts = [row.answers for row in rows]
    by_solution = ("pass_id", "solution")
    table: dict[str, Any] = {
        "utc_start": ("pass_id", [utc(row.first_s) for row in rows]),
        "utc_end": ("pass_id", [utc(row.last_s) for row in rows]),
        "samples": ("pass_id", [row.samples for row in rows]),
        "probability": (by_solution, padded([row.probability for row in rows])),
        "decided": flags([verdict.decided for verdict in verdicts]),
        "unique": flags([verdict.unique for verdict in verdicts]),
        **{
            f"constrained_{axis}": flags([verdict.constrained[k] for verdict in verdicts])
            for k, axis in enumerate("xyz")
        },
        "fits": flags([verdict.fits for verdict in verdicts]),
        "search_complete": flags([verdict.search_complete for verdict in verdicts]),
        "columns_checked": ("pass_id", [row.columns_checked for row in rows]),
        "utc_at": ("pass_id", [utc(row.at_s) for row in rows]),
    }
    for k, name in enumerate(("speed_low", "speed_median", "speed_high")):
        table[name] = by_solution, padded([row.speed[:, k] for row in rows])
    for name in ("omega", "sigma"):
        for k, axis in enumerate("xyz"):
            table[f"{name}_{axis}"] = (
                by_solution,
                padded([getattr(row, name)[:, k] for row in rows]),
            )
    table["constrained_speed"] = flags([verdict.speed.constrained for verdict in verdicts])
    table["speed_sigma"] = "pass_id", [verdict.speed.sigma for verdict in verdicts]
    table["speed_below"] = "pass_id", [verdict.speed.below for verdict in verdicts]
    table["why_not_decided"] = "pass_id", [verdict.why_not for verdict in verdicts]
    return table


def more_effort(given: float) -> str:
    """Return in words what to do if the computing budget was spent: give ten times the effort, and at least 10."""
    return f"give more effort (`--effort {10 * max(given, 1.0):g}`)"


def advise_lower_limit(limit_rad_s: float) -> str:
    """Return in words what to do if the starts are dense enough only up to a limit of the rate, rounded down to three digits."""
    limit = np.degrees(limit_rad_s)
    unit = 10.0 ** (np.floor(np.log10(limit)) - 2)
    return (
        f"if no rate is faster than {np.floor(limit / unit) * unit:.4g} deg/s, give it as "
        "`--max-rate-deg-s`"
    )


def rates_words(result: xr.Dataset) -> str:
    """Return the summary of a result of `rates` in words: how many passes are decided, then a line for each note.

    The order is: passes that do not fit, columns, passes that are not constrained or not unique, an incomplete search, the sensors.
    """
    decided, unique, fits = (result[name].values for name in ("decided", "unique", "fits"))
    constrained = np.all([result[f"constrained_{axis}"].values for axis in "xyz"], axis=0)
    attrs = result.attrs
    notes = [
        f"{int(decided.sum())} of {len(decided)} passes decided (unique, all components and the speed constrained, fits, "
        "search complete)"
    ]
    if count := int((~fits).sum()):
        notes.append(
            f"{count_of_passes(count)}: NO SOLUTION FITS. Possible causes: external torque, changing wheel speed, wrong "
            "inertia, shaded panels, a drifting zero, faulty data. Or light of the Earth on the panels: a `noise` of 3 % of full "
            "Sun under [telemetry] allows for it"
        )
    notes += [attrs[name] for name in ("columns_doubt", "columns_rivals") if name in attrs]
    if count := int((fits & unique & ~constrained).sum()):
        notes.append(
            f"{count_of_passes(count)}: single solution, but not all rate components are constrained"
        )
    only_limit = ~result["constrained_speed"].values & result["search_complete"].values
    if count := int((fits & unique & constrained & only_limit).sum()):
        notes.append(
            f"{count_of_passes(count)}: the error of the speed exceeds the speed, so only an upper limit is given"
        )
    if count := sum(model != AS_STATED for model in result["model"].values):
        notes.append(f"{count_of_passes(count)}: an alternative model fits better, as named below")
    # unique together with the solution that has the same rates and the opposite Sun direction
    sign_open = fits & unique & (result["probability"].values[:, 0] < DECIDED)
    if count := int(sign_open.sum()):
        notes.append(
            f"{count_of_passes(count)}: the sign of the Sun direction is ambiguous; rates are unaffected, attitude is unknown"
        )
    if unlisted := attrs["symmetric_unlisted"]:
        notes.append(
            f"{count_of_passes(unlisted)}: a rotation or mirror of the body gives the same readings; that solution is not listed"
        )
    count = int((fits & ~unique).sum()) - unlisted
    if count and "alike" in attrs:
        notes.append(f"{count_of_passes(count)} with several solutions: {attrs['alike']}")
    elif count:
        notes.append(
            f"{count_of_passes(count)} with several solutions, which mostly differ by whole revolutions between samples: see "
            "passes.csv"
        )
    if count := attrs["cut_passes"]:
        notes.append(
            f"{count_of_passes(count)}: SEARCH STOPPED at the computing budget, best solution so far is shown: "
            f"{more_effort(attrs['effort_given'])}"
        )
    if attrs.get("column_tests_cut"):
        notes.append(
            f"not every other order of columns was tried: {more_effort(attrs['effort_given'])}"
        )
    if count := attrs["coarse_passes"]:
        notes.append(
            f"{count_of_passes(count)}: coarse search, a solution may be missing: "
            f"{advise_lower_limit(attrs['fine_up_to_rad_s'])}"
        )
    for reason in (WHEEL_LACKS, WHEEL_CHANGES):
        if count := sum(reason in str(why) for why in result["why_not_decided"].values):
            notes.append(f"{count_of_passes(count)}: {reason}")
    if wheels := attrs["wheels_untold"]:
        notes.append(
            f"WHEEL SPEED UNKNOWN ({wheels}): assumed 0, so the solution may be wrong. Give speed_rad_s or a speed_column, or "
            "remove the wheel if it is at rest"
        )
    if attrs["wheel_change"]:
        notes.append(
            f"a wheel changed its speed in a pass ({attrs['wheel_change']}), which the file does not state: give a speed_column if "
            "its speed is measured"
        )
    late, sigma = attrs["sensors_late_s"], attrs["sensors_late_sigma_s"]
    if np.isfinite(late):
        notes.append(
            f"gyro, magnetometer and attitude are {late:.2f} +- {sigma:.2f} s late ({attrs['sensors_late_from']})"
        )
    if attrs["frame_N"] == FIELD_Z_LOCAL:
        notes.append(FIELD_ALONE)
    elif not any(attrs.get(f"{name}_used") for name in (*OTHER_SENSORS, "rate_size")):
        notes.append(SUN_ALONE)
        limit = np.degrees(attrs["max_rate_rad_s"])
        if attrs.get("max_rate_assumed") and decided.any() and limit < SELDOM_FASTER_DEG_S:
            notes.append(
                f"no rate above {limit:.3g} deg/s was searched ({LARGEST_TURNS:g} revolutions between samples), as no largest rate "
                "is stated: if the body may be faster, give `--max-rate-deg-s`"
            )
        if count := attrs["no_sphere"]:
            notes.append(
                f"{count_of_passes(count)}: the search assumed a sphere, which does not fit this motion: GIVE ITS INERTIA "
                "(inertia_kg_m2)"
            )
    unit = attrs["times_rounded_to_s"]
    fastest = float(np.nanmax(np.linalg.norm(result["omega_B"].values, axis=1), initial=0.0))
    # the turn (rad) in one sigma of a rounded time
    if fastest * unit / np.sqrt(12) > SearchSettings.least_drift_rad:
        notes.append(
            f"times are multiples of {unit:.3g} s at uneven intervals: they count as rounded, with an error that every sigma "
            "includes; times with more digits give smaller sigmas"
        )
    return "\n".join(notes)


def alike_motions(vehicle: Vehicle) -> str:
    """Return in words which solutions panels on shared inputs cannot distinguish; empty if they distinguish all."""
    count = len(vehicle.response_in().symmetries)
    if count == 1:
        return ""
    shared = [panel_input.name for panel_input in vehicle.inputs if len(panel_input.panels) > 1]
    which = f"{'inputs' if len(shared) > 1 else 'input'} {', '.join(shared)}"
    copies = "a mirror solution" if count == 2 else f"{count - 1} symmetric solutions"
    return (
        f"{which} do not show which panel is lit, so each solution has {copies} with some signs reversed. A gyro, magnetometer or "
        "Sun sensor resolves this; inertia or wheels sometimes do"
    )


def count_of_passes(count: int) -> str:
    """Return a number of passes in words, such as 1 pass, 2 passes."""
    return f"{count} pass" + "es" * (count > 1)


def join_reasons(*reasons: str) -> str:
    """Return reasons as one text, without empty ones."""
    return "; ".join(str(reason) for reason in reasons if str(reason))
