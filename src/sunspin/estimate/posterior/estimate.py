"""The calibrated posterior: every motion that panel readings allow, with its probability, or the word that none fits."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import logsumexp

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance, with_units
from sunspin.dynamics.torques import acting
from sunspin.environment import Environment
from sunspin.estimate.effort import Effort, may_go_on, share_of_left
from sunspin.estimate.equivalence import columns_seen
from sunspin.estimate.passes import AS_STATED, UNCHECKED, table
from sunspin.estimate.posterior.brightness import brightness
from sunspin.estimate.posterior.check import Check, check
from sunspin.estimate.posterior.data import Readings, group, readings
from sunspin.estimate.posterior.fit import chunk_rows
from sunspin.estimate.posterior.hypotheses import (
    ASKED_NOISE,
    ASKED_P,
    ASKED_WEIGHT,
    STATED,
    Hypothesis,
    Mixed,
    Sampled,
    likely,
    log_mass,
    mixed,
    others,
    searched,
)
from sunspin.estimate.posterior.importance import Known, resampled, sample
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import MOST_TURNED, Model, model, require_computable, under
from sunspin.estimate.posterior.modes import (
    NO_TORQUES,
    Modes,
    Plan,
    Search,
    at_reference,
    beyond_all,
    plan,
    require_few,
    within,
)
from sunspin.estimate.posterior.period import with_periods
from sunspin.estimate.posterior.verdict import (
    COUNTS,
    LEAST_WEIGHT,
    TOO_FEW,
    Found,
    believed,
    dark_stretch,
    refused,
    spoilt_panels,
    verdict,
)
from sunspin.estimate.terms.period import Period
from sunspin.estimate.verdict import alike_motions
from sunspin.estimate.wheel_speeds import as_measured, untold
from sunspin.solve.weights import effective_draws
from sunspin.vehicle import Vehicle

DIRECTION_ERROR = 1e-5
"""Error of directions (rad) in the likelihood."""

SURELY_LIT = 5.0
"""Sigmas of noise above which a reading is sunlight."""

EDGE = 0.97
"""Draws beyond this part of the largest rate searched say that the truth may be outside."""

FEW_BODIES, MOST_BODIES = 0.2, 0.5
"""Part of the prior of the inertia that describes bodies: below the first it leaves no draws, above the second it is no cause."""

ADVISED_SIGMAS = (0.1, 0.03, 0.01, 3e-3, 1e-3)
"""Relative sigmas of the inertia that may be advised, the largest first."""

TAG_CHANCE = 0.05
"""Chance with exact time tags below which residuals in step with the powers' rates of change are taken for errors of these."""

OTHERS_DRAWS = 0.5
"""Part of the draws under the model as stated that each other hypothesis gets, as long as the former holds its own."""

BEYOND_DRAWS = 0.1
"""Part of the draws where no motion fits by far: two rounds of them say by how much."""

LOST = 1e-3
"""A hypothesis with this part of the evidence of the model as stated needs no good draws."""

MOST_EFFORT = 5e7
"""Motions carried over one interval between two samples, search and draws together, after which no more draws are begun: about five
minutes of one core. Without it draws about 300 modes, each under six sizes of a torque, did not end in seven."""

CHECKED = 400
"""Draws by which the model as stated is judged before others are searched for."""

LONG_SEARCH = 400_000
"""Motions times samples fitted, two minutes of one core, beyond which no search under torques follows: it would take twice as long
again."""

OF_REGION = 4000
"""Draws of equal weight by which mean and covariance of a region are told."""


def posterior(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    priors: Mapping[str, Any] | None = None,
    seed: int = 0,
    *,
    begin_s: float | None = None,
    end_s: float | None = None,
    phase: str | None = None,
    observations: Sequence[Mapping[str, Any]] = (),
    wheel_mode: str | Sequence[str] = "coast",
    draws: int = 4000,
    workers: int | None = None,
    store: str | Path | None = None,
    progress: bool = False,
    environment: Environment | None = None,
    torques: Sequence[str] = (),
    periods: Sequence[Period] = (),
) -> xr.DataTree:
    """The posterior of the motion in free flight from the raw readings of all samples, dark panels included.

    Parameters
    ----------
    vehicle : Vehicle
    telemetry : Dataset of `read_telemetry`
        One stretch of motion without blows; `begin_s`, `end_s` (s from the epoch) or `phase` cut it out.
    priors : mapping, optional
        `steady_torque`, the most that a steady torque of which nobody told may turn the body over the samples (deg; 300 unless
        given, 0: none acts). Relative sigmas, zero for what is known: `inertia` (of each moment), `wheel_speed`, `wheel_inertia`,
        `friction`, `gain` (each panel's), `scale` and `noise` (of the logarithm); `tilt`, of the angles in rad by which each
        panel's normal is off to each side, and `tilt_common`, of one turn of all panels about each axis; `time_s`, sigma of the
        samples' times in s (unless given they are taken for exact, until the residuals say otherwise);
        `max_rate_rad_s`, the ball in which rates are uniform. Default: what the vehicle's file states, else the values in
        `sunspin.estimate.posterior.model`; the result's attributes say which.
    seed : int
        The same seed gives the same result to 1e-9, for any number of workers and however often the run was stopped.
    observations : list of mappings
        ``{"kind": "rate" | "gyro" | "direction" | "field", "t_s": ..., "value": ..., "sigma": ...}``: angular speed, body rate,
        direction of the Sun seen otherwise, or another direction in the body, such as the magnetic field's, of which the angle
        from the Sun is known (`angle_rad`; `sigma` in rad); `t_s` from the epoch.
    wheel_mode : "coast", "hold", "brake", or one per wheel
    draws : int
        Draws in the result.
    workers, store, progress
        As in :func:`sunspin.compute.rows.ensemble`; the folder `store` resumes every stage.
    environment : Environment, optional
        What surrounds the body, on the telemetry's clock (:func:`sunspin.environment.circular`).
    torques : list, optional
        Torques that act on the body, by name (`sunspin.dynamics.torques.TORQUES`). Where they depend on directions beside the
        Sun's, the turn about the Sun at the reference sample is an unknown, `turn_about_sun_rad`.
    periods : list of Period, optional
        Periods seen from outside: group `period` says what they decide
        (:func:`sunspin.estimate.posterior.period.with_periods`); the draws stay as they are.

    Returns
    -------
    xarray.DataTree
        Group `posterior` over (chain, draw): `omega_B` (rad/s), `sun_B`, `wheel_speed_rad_s` at the first sample, the other
        unknowns by name, `solution_id`, `log_weight` (all alike: the draws are resampled). Group `solutions`: centre, covariance,
        weight, evidence, chi-square, number of starts. Group `search`: trace of the enumeration; group `sampling`: trace of the
        evidence. Group `passes`, of one pass: what may be believed, the variables of `passes.csv`
        (:func:`sunspin.estimate.passes.table`). attrs: `verdict` and `verdict_word` ("unique", "aliases", "line", "not sure",
        "not explained"), `p_value`.

    Raises
    ------
    InputError
        Priors, observations or a window that make no sense; too few samples.
    MotionError
        A torque without the environment that it needs.
    """
    _whole(seed, draws)
    data, start_s, remarks = readings(vehicle, telemetry, begin_s, end_s, phase, observations)
    unsure = ", ".join(untold(vehicle, telemetry))
    vehicle = as_measured(vehicle, telemetry, start_s)
    scale = brightness(vehicle, data)
    unknown, told = model(vehicle, priors, scale, wheel_mode)
    unknown = under(unknown, acting(torques, environment, start_s))
    chosen = (require_few if (priors or {}).get("max_rate_rad_s") else plan)(unknown, data, scale)
    there, chosen = at_reference(unknown, chosen, data)
    here = data.since(chosen.anchor)
    require_computable(there, here.t_s, min(chosen.limit, there.max_rate))
    search = Search(workers, None if store is None else Path(store), progress)
    with Effort(MOST_EFFORT):
        modes = within(search.modes(there, here, chosen, scale), there.max_rate)
        stated = Hypothesis(STATED, 0.0, Likelihood(there, here, DIRECTION_ERROR), modes)
        tried, lost = _tried(
            stated,
            seed,
            search,
            chosen,
            scale,
            float((priors or {}).get("steady_torque", MOST_TURNED)),
        )
        drawn, picked, checked = _together(tried, seed, draws)
        noticed = (
            checked.tag_p < TAG_CHANCE
            and "time_s" not in (priors or {})
            and not refused(checked.p, checked.noise_sigmas)
        )
        off = checked.tag_s if noticed else 0.0
        if off and not may_go_on():
            lost.append("the computing budget left no draws with errors of time tags")
        elif off:
            there = replace(there, time_sigma_s=off)
            again = [one.hypothesis.tagged(off) for one in tried]
            tried = _sampled(again[:1], seed, search, 1.0)
            tried += _sampled(again[1:], seed, search, OTHERS_DRAWS, tried[0])
            lost += _unsampled(again, tried)
            drawn, picked, checked = _together(tried, seed, draws)
            told["time_s"] = f"{off:.2g} s (from the residuals)"
    likeliest = drawn.tried[int(np.argmax(drawn.weight))].hypothesis  # its search is in doubt
    notes = [*likeliest.modes.notes, *dict.fromkeys(lost)]
    if off:
        notes.append(
            f"time tags seem to be off by about {off:.1g} s; state their error as the prior time_s"
        )
    prior_sigma = min(chosen.limit, there.max_rate) / np.sqrt(5)  # of a component, even in the ball
    tree = _tree(there, modes, drawn, picked, prior_sigma)
    tree.attrs.update(
        _about(vehicle, telemetry, priors, told, seed, start_s, chosen, unknown, data)
    )
    edge = np.mean(
        np.linalg.norm(drawn.state.take(picked).omega, axis=1)
        > EDGE * min(chosen.limit, there.max_rate)
    )
    if edge > 0.01:
        notes.append("the rates reach the limit of the search; raise max_rate_rad_s")
    if unsure:
        cure = "give speed_rad_s or a speed_column, or remove a wheel that is at rest"
        notes.append(f"WHEEL SPEED UNKNOWN ({unsure}): assumed 0; {cure}")
    modes = replace(modes, notes=tuple(notes))
    tree.attrs["time_sigma_s"] = there.time_sigma_s
    found = _judge(tree, modes, drawn, checked, here, vehicle, remarks)
    checked_by_others = bool(observations) or columns_seen(vehicle, telemetry)
    row = believed(
        found, tree, prior_sigma, bool(off), AS_STATED if checked_by_others else UNCHECKED
    )
    tree["passes"] = xr.Dataset(table([row], telemetry.attrs.get("epoch_utc")), {"pass_id": [0]})
    tree.attrs["verdict"] += (
        "; decided" if row.answers.decided else f"; not decided: {row.answers.why_not}"
    )
    if periods:
        with_periods(vehicle, tree, periods)
    return with_units(tree)


def _sampled(
    every: list[Hypothesis], seed: int, search: Search, part: float, first: Sampled | None = None
) -> list[Sampled]:
    """The posteriors under hypotheses, about their modes; the others than the `first` may learn from its draws."""
    made = []
    for i, one in enumerate(every):
        known, least = None, -np.inf
        if first is not None:
            pairs = zip(
                first.hypothesis.likelihood.model.unknowns,
                one.likelihood.model.unknowns,
                strict=False,
            )
            known = Known(first.drawn, np.array([wider.sigma / own.sigma for own, wider in pairs]))
            least = first.drawn.evidence - one.log_prior + np.log(LOST)
        hopeless = beyond_all(one.likelihood, one.modes)
        least, share = (np.inf, BEYOND_DRAWS * part) if hopeless else (least, part)
        chunk = chunk_rows(one.likelihood)
        with share_of_left(1 / (len(every) - i + 1)) as effort:  # as much again is for what follows
            draws = sample(one.likelihood, one.modes, seed, search.run, chunk, share, known, least)
        if draws is not None:
            made.append(Sampled(one, replace(draws, cut=effort.cut)))
        elif one.what == STATED:
            raise _nothing_drawn(one)
    return made


def _nothing_drawn(stated: Hypothesis) -> InputError:
    """Return the refusal if no draw about the modes of the model as stated is possible.

    The cause is the sigma of the inertia, if few bodies within it can exist, else the largest rate.
    """
    limit, share = stated.likelihood.model.max_rate, stated.likelihood.model.log_truncated
    if share < np.log(FEW_BODIES):
        vehicle = stated.likelihood.model.vehicle
        advised = (
            sigma
            for sigma in ADVISED_SIGMAS
            if model(vehicle, {"inertia": sigma}, 1.0)[0].log_truncated > np.log(MOST_BODIES)
        )
        sigma = next(advised, ADVISED_SIGMAS[-1])
        return InputError(
            "hardly any inertia within its sigma is that of a body, and none that was drawn fits the readings",
            got=f"{np.exp(share):.2g} of the prior",
            do=f"give --prior inertia={sigma:g}, or smaller sigmas in the vehicle file",
        )
    return InputError(
        "the motion that fits best lies at the end of what the priors allow, and next to nothing of it within",
        got=f"max_rate_rad_s {limit:.3g}",
        do=f"give --prior max_rate_rad_s={2 * limit:.2g}",
    )


def _unsampled(asked: list[Hypothesis], tried: list[Sampled]) -> list[str]:
    """Doubts about hypotheses that promise to count, by Laplace's method, and are left out since no draw of them was possible."""
    made, mass = {one.hypothesis.what for one in tried}, np.array([log_mass(one) for one in asked])
    counts = mass > logsumexp(mass) + np.log(COUNTS)
    lost = [
        one.what for one, some in zip(asked, counts, strict=True) if some and one.what not in made
    ]
    return [
        f"{what} may explain the readings too, but no motion that it allows could be drawn"
        for what in lost
    ]


def _tried(
    stated: Hypothesis, seed: int, search: Search, chosen: Plan, scale: float, most_deg: float
) -> tuple[list[Sampled], list[str]]:
    """The model as stated and the others, sampled; those with a torque from a search of their own where there is cause. And doubts
    about those that could not be sampled."""
    (first,) = _sampled([stated], seed, search, 1.0)
    every = list(others(first, search, most_deg))
    asked = likely(stated, every)
    tried = [first, *_sampled(asked, seed, search, OTHERS_DRAWS, first)]
    checked = _together(tried[:1], seed, CHECKED)[2]
    fits = (
        checked.p > ASKED_P
        and abs(checked.noise_sigmas) < ASKED_NOISE
        and mixed(tried).weight[0] > ASKED_WEIGHT
    )
    lost: list[str] = []
    if not fits and most_deg and (search.fitted > LONG_SEARCH or not may_go_on()):
        lost = [NO_TORQUES]
    elif (
        not fits and most_deg and stated.modes.complete
    ):  # else motions that were not followed may fit without a torque
        asked = likely(
            stated,
            [
                searched(one, search, chosen, scale) if one.likelihood.model.frame else one
                for one in every
            ],
        )
        tried = [first, *_sampled(asked, seed, search, 1.0)]
    return tried, _unsampled([stated, *asked], tried) + lost


def _together(tried: list[Sampled], seed: int, draws: int) -> tuple[Mixed, np.ndarray, Check]:
    """All hypotheses weighed: draws, those told, and whether readings like these come from them."""
    drawn = mixed(tried)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
    picked = resampled(drawn.log_weight, draws, rng)
    found, share = [], []
    for one, places, own in drawn.each(picked):
        found.append(check(one.hypothesis.likelihood, one.drawn.state.take(own), rng))
        share.append(len(places) / len(picked))
    means = [
        sum(part * value for part, value in zip(share, each, strict=True))
        for each in zip(*map(astuple, found), strict=True)
    ]
    return drawn, picked, Check(*means)


def _whole(seed: Any, draws: Any) -> None:
    for name, value, least in (("seed", seed, 0), ("draws", draws, 1)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise InputError(f"{name} must be a whole number of at least {least}", got=value)


def _tree(
    model_: Model, modes: Modes, drawn: Mixed, picked: np.ndarray, prior_sigma: float
) -> xr.DataTree:
    omega, sun, wheels, steady = drawn.first(picked)
    values = drawn.values(picked)
    each = ("chain", "draw")
    variables: dict[str, Any] = {
        "omega_B": (
            (*each, "axis"),
            omega[None],
            {"units": "rad s-1", "long_name": "body rate at the first sample"},
        ),
        "sun_B": (
            (*each, "axis"),
            sun[None],
            {"units": "1", "long_name": "direction to the Sun at the first sample"},
        ),
        "wheel_speed_rad_s": ((*each, "wheel"), wheels[None], {"units": "rad s-1"}),
        "solution_id": (each, drawn.region[picked][None]),
        "log_weight": (each, np.full((1, len(picked)), -np.log(len(picked))), {"units": "1"}),
        "log_likelihood_sum": (each, drawn.log_likelihood[picked][None], {"units": "1"}),
    }
    about = {
        "units": "rad s-2",
        "long_name": "steady torques over the mean moment of inertia, in body axes at the first sample",
    }
    variables["steady_torque"] = ((*each, "stays_in", "axis"), steady[None], about)
    for i, x in enumerate(model_.unknowns):
        if x.kind != "wheel_speed":
            about = {"units": x.unit, "prior_centre": x.centre, "prior_sigma": x.sigma}
            variables[x.name] = (each, values[:, i][None], about)
    coords = {
        "axis": ["x", "y", "z"],
        "stays_in": ["body", "space"],
        "wheel": [wheel.name for wheel in model_.vehicle.wheels],
        "chain": [0],
        "draw": np.arange(len(picked)),
    }
    groups = {
        "posterior": xr.Dataset(variables, coords),
        "solutions": _modes(drawn, prior_sigma),
        "search": xr.Dataset(
            {
                name: ("stage", np.array(modes.trace)[:, i])
                for i, name in enumerate(("samples", "hypotheses", "kept"))
            }
        ),
        "sampling": xr.Dataset(
            {
                name: ("round", drawn.trace[:, i])
                for i, name in enumerate(("log_evidence", "effective_share", "pareto_k"))
            }
        ),
    }
    return xr.DataTree.from_dict(groups)


def _listed(drawn: Mixed) -> int:
    """How many regions are listed: by falling weight, up to the first that has too little of it, or of draws."""
    for region, share in enumerate(drawn.share):
        if share <= LEAST_WEIGHT or (share < COUNTS and _effective(drawn, region) < TOO_FEW):
            return max(1, region)
    return len(drawn.share)


def _effective(drawn: Mixed, region: int) -> float:
    """How many draws of equal weight those of a region are worth."""
    own = drawn.log_weight[drawn.region == region]
    return effective_draws(np.exp(own - logsumexp(own)))


def _modes(drawn: Mixed, prior_sigma: float) -> xr.Dataset:
    """The regions, by falling weight, from their draws; `prior_sigma` (rad/s) of a component of the rate."""
    count = _listed(drawn)
    rows, rng = [], np.random.default_rng(0)
    for region in range(count):
        every = np.flatnonzero(drawn.region == region)
        inside, times = np.unique(
            every[resampled(drawn.log_weight[every], OF_REGION, rng)], return_counts=True
        )
        share = times / OF_REGION
        omega, sun, *_ = drawn.first(inside)
        mean = share @ omega
        middle = share @ sun
        best, effective = int(np.argmax(drawn.log_likelihood[inside])), _effective(drawn, region)
        off = omega - mean
        covariance = np.einsum("n,ni,nj->ij", share, off, off)
        rows.append(
            (
                mean,
                _of_proposed(drawn, every, mean, prior_sigma)
                if effective < TOO_FEW
                else covariance,
                middle / np.linalg.norm(middle),
                drawn.share[region],
                drawn.evidence + np.log(drawn.share[region]),
                omega[best],
                *_chi_square(drawn, int(inside[best])),
                int(drawn.starts[region]),
                effective,
            )
        )
    names = (
        ("omega_B", ("solution", "axis"), "rad s-1"),
        ("omega_cov_B", ("solution", "axis", "axis2"), "rad2 s-2"),
        ("sun_B", ("solution", "axis"), "1"),
        ("probability", ("solution",), "1"),
        ("log_evidence", ("solution",), "1"),
        ("best_omega_B", ("solution", "axis"), "rad s-1"),
        ("chi_square", ("solution",), "1"),
        ("lit_readings", ("solution",), "1"),
        ("starts", ("solution",), "1"),
        ("effective_draws", ("solution",), "1"),
    )
    columns = zip(names, zip(*rows, strict=True), strict=True)
    return xr.Dataset(
        {name: (dims, np.array(values), {"units": unit}) for (name, dims, unit), values in columns},
        coords={"solution": np.arange(count), "axis": ["x", "y", "z"]},
    )


def _of_proposed(
    drawn: Mixed, every: np.ndarray, mean: np.ndarray, prior_sigma: float
) -> np.ndarray:
    """Covariance (3, 3) of a region's rates about their mean where few of its draws (`every`) have weight, so that theirs would be
    near zero: that of all draws proposed there, which spread more widely; where these are too few, the prior's."""
    if len(every) < TOO_FEW:
        return prior_sigma**2 * np.eye(3)
    off = drawn.first(every[:: -(-len(every) // OF_REGION)]).omega - mean
    return np.asarray(off.T @ off / len(off))


def _chi_square(drawn: Mixed, i: int) -> tuple[float, int]:
    """Of a draw, sum of squared differences of lit readings, in stated sigmas, and their number."""
    one = drawn.tried[int(drawn.of[i])]
    likelihood, state = one.hypothesis.likelihood, one.drawn.state.take([int(drawn.row[i])])
    raw, _ = likelihood.misfit(likelihood.predict(state), state.u)
    used, lit, _ = likelihood.kinds
    return float(np.sum((raw[0] / likelihood.stated)[used & lit] ** 2)), int(
        np.count_nonzero(used & lit)
    )


def _about(
    vehicle, telemetry, priors, told, seed, start_s, chosen, unknown: Model, data: Readings
) -> dict[str, Any]:
    comments = {key: telemetry.attrs[key] for key in ("comments",) if key in telemetry.attrs}
    return provenance("posterior", telemetry, **comments, **vehicle.result_attributes) | {
        "seed": int(seed),
        "t_first_s": start_s,
        "t_last_s": start_s + float(data.t_s[-1]),
        "noise": float(np.median(data.sigma)),
        "noise_from": data.noise_from,
        "samples": len(data),
        "reference_sample": chosen.anchor,
        "priors": json.dumps(told),
        "priors_given": json.dumps({str(key): value for key, value in (priors or {}).items()}),
        "wheel_mode": json.dumps(unknown.wheel_mode),
        "max_rate_rad_s": unknown.max_rate,
        "searched_rate_rad_s": float(chosen.limit),
        "torques": json.dumps([torque.name for torque in unknown.acting.torques]),
    }


def _judge(
    tree: xr.DataTree,
    modes: Modes,
    drawn: Mixed,
    checked: Check,
    data: Readings,
    vehicle: Vehicle,
    remarks: list[str],
) -> Found:
    regions = group(tree, "solutions")
    doubts = list(modes.notes)
    cut = any(sampled.drawn.cut for sampled in drawn.tried)
    if cut:
        doubts.append(
            f"the draws stopped at the computing budget of {MOST_EFFORT / 1e6:.3g} million motions, "
            f"with an effective sample size of {drawn.effective:.0f}"
        )
    told = regions["probability"].values >= 0.01
    if np.any(regions["starts"].values[told] == 1):
        doubts.append("a solution was reached from one start only, so others may be missing")
    bright = data.used & (data.value > np.maximum(data.threshold, SURELY_LIT * data.sigma))
    awake = bright.any(
        axis=1
    )  # where nothing is lit the vehicle may have been in shadow, which is no panel's fault
    spoilt = spoilt_panels(vehicle.input_names, checked.outliers[awake], data.lit[awake])
    rate, covariance = regions["omega_B"].values, regions["omega_cov_B"].values
    found = Found(
        regions["probability"].values,
        rate,
        np.sqrt(np.linalg.eigvalsh(covariance)[:, -1].clip(0)),
        regions["starts"].values,
        float(np.median(np.diff(data.t_s))),
        checked.p,
        checked.noise_sigmas,
        spoilt,
        drawn.tail,
        drawn.effective,
        doubts,
        np.sqrt((rate**2).sum(axis=1) + np.trace(covariance, axis1=1, axis2=2)),
        dark_stretch(tree.attrs["t_first_s"] + data.t_s, awake),
        modes.complete and not cut,
    )
    word, text = verdict(found)
    if word != "not explained" and (alike := alike_motions(vehicle)):
        text += f"; {alike}"
    likeliest, weight = max(drawn.said.items(), key=lambda one: one[1])
    if likeliest != STATED:
        text += f"; an alternative model fits better: {likeliest} (probability {weight:.2f})"
    if word == "not explained":
        text += (
            f"; rates up to {np.degrees(tree.attrs['searched_rate_rad_s']):.3g} deg/s were searched"
        )
    tree.attrs |= {
        "verdict": text,
        "verdict_word": word,
        "p_value": checked.p,
        "noise_sigmas": checked.noise_sigmas,
        "pareto_k": drawn.tail,
        "effective_draws": drawn.effective,
        "log_evidence": drawn.evidence,
        "remarks": "; ".join(remarks),
        "spoilt_readings": float(checked.outliers.sum()),
        "hypotheses": json.dumps({what: round(share, 4) for what, share in drawn.said.items()}),
    }
    return found
