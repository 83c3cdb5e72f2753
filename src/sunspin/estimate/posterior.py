"""Every motion of a lander that panel readings allow, with its probability, or the statement that none fits (docs/posterior.md).

The steps are a search under the nominal model, fits of its motions under constant torques, draws of all models, and the verdict.
Unlike in `rates` no random torques act between samples: the state at one instant, the reference, and the unknowns give the whole
motion. So the readings also determine inertia and friction.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.special import logsumexp
from tqdm import tqdm

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance, with_units
from sunspin.base.untrusted import require_whole
from sunspin.estimate.budget import Budget
from sunspin.estimate.equivalence import columns_seen
from sunspin.estimate.lander.carrier import Shooting
from sunspin.estimate.lander.grid import choose_reference, grid_starts
from sunspin.estimate.lander.mixture import Mixture
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import Doubt, LanderMotions, ModelFit
from sunspin.estimate.lander.periods import draws_by_periods
from sunspin.estimate.lander.priors import constant_torques, with_priors
from sunspin.estimate.lander.sample import PredictiveCheck, resampled, sample
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.lander.tree import LEAST_COUNTED, group, tree_of
from sunspin.estimate.lander.verdict import (
    PosteriorFindings,
    accused_panels,
    dark_stretch,
    explained_part,
    one_plane,
    pass_row,
    posterior_words,
)
from sunspin.estimate.lander.window import Window, observe_window
from sunspin.estimate.model import AS_STATED, inertia_sigma
from sunspin.estimate.observe import wheels_of_unknown_speed
from sunspin.estimate.periods import PeriodSeen
from sunspin.estimate.search import search
from sunspin.estimate.settings import POSTERIOR, PosteriorSettings
from sunspin.estimate.verdict import COLUMNS_STATED, COLUMNS_UNCHECKED, alike_motions, passes_table
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle

EDGE, AT_EDGE = 0.97, 0.01
"""If more than the share `AT_EDGE` of the draws is faster than `EDGE` times the limit of the search, the truth may be beyond it."""

SURELY_LIT = 5.0
"""Sigmas of noise above which a reading is sunlight."""

FEW_BODIES, MOST_BODIES = 0.2, 0.5
"""Parts of the prior that describe bodies which can exist. Below the first the inertia is blamed if nothing can be drawn. The sigma
that is then advised leaves more than the second."""

ADVISED_SIGMAS = (0.1, 0.03, 0.01, 3e-3, 1e-3)
"""Relative sigmas of the inertia that may be advised, the largest first."""


class NominalSearch(NamedTuple):
    """The result of the search under the nominal model.

    `carrier`: the search, with its model and its remarks; `motions`: those that it has left, and `fit`: these fitted to all samples
    with all unknowns; `prior_words`: name of each prior -> size and source in words.
    """

    assessment: Assessment
    window: Window
    carrier: Shooting
    motions: LanderMotions
    fit: ModelFit
    prior_words: dict[str, str]


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
    progress: bool | Callable[[str], None] = False,
    periods: Sequence[PeriodSeen] = (),
    settings: PosteriorSettings = POSTERIOR,
) -> xr.DataTree:
    """Return the posterior of the motion in free flight from the readings of all samples, dark panels included.

    Parameters
    ----------
    vehicle : Vehicle
    telemetry : Dataset of `read_telemetry`
        One stretch of motion without impacts; `begin_s`, `end_s` (s from the epoch) or `phase` cut it out.
    priors : mapping, optional
        Upper limits: `max_rate_rad_s`, below which the rate vector is uniform; `steady_torque`, the largest rotation over the
        samples by a constant torque (deg; 300 unless given, 0: none acts). Relative sigmas, zero for what is known: `inertia` (of
        each moment), `wheel_speed`, `wheel_inertia`, `friction`, `gain` (of each panel), `scale` and `noise` (of the logarithm). In
        rad: `tilt`, of each panel about two axes, and `tilt_common`, of all panels about each axis. In s: `time_s`, of the time of
        each sample. Default: what the vehicle file states, else the values in :mod:`sunspin.estimate.settings`; the attributes of
        the result say which.
    seed : int
        The same seed gives the same result to 1e-9 for any number of workers.
    observations : list of mappings
        ``{"kind": "rate" | "gyro" | "direction" | "field", "t_s": ..., "value": ..., "sigma": ...}``: angular speed, body rate,
        direction to the Sun, or another direction in the body with its angle from the Sun (`angle_rad`; `sigma` in rad); `t_s`
        from the epoch.
    wheel_mode : "coast", "hold", "brake", or one per wheel
    draws : int
        Draws in the result.
    workers : int, optional
        Threads, by default one per core.
    progress : bool, or a function of a line
        Say on the standard error what is being done; a function is called with each line instead.
    periods : list, optional
        Rotation periods observed from outside: the group `period` has weights of the draws by them; the draws stay as they are.
    settings : PosteriorSettings
        Numbers that tune the search and the sampling.

    Returns
    -------
    xarray.DataTree
        Group `posterior` over (chain, draw): `omega_B` (rad/s), `sun_B`, `wheel_speed_rad_s` at the first sample, the unknowns by
        name, `solution_id`, `log_weight` (all alike). Group `solutions`: mean and covariance of the rate, probability, evidence,
        chi-square, number of starts. Groups `search` and `sampling`: what was fitted and kept, and the evidence of each round.
        Group `passes`: the variables of `passes.csv`. attrs: `verdict` and `verdict_word` ("unique", "aliases", "line",
        "not sure", "not explained"), `p_value`.

    Raises
    ------
    InputError
        Priors, observations or a window that make no sense; too few samples.
    """
    require_whole("seed", seed, 0)
    require_whole("draws", draws, 1)
    # streams of random numbers: 0 to 2 for the models, 3 to 5 for them after a search under torques, 6 for the result, 7 for checks
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(8)]
    of_models, of_result, of_checks = streams[:6], streams[6], streams[7]
    say = progress if callable(progress) else _write_line if progress else lambda _: None
    say("searching every motion that the readings allow")
    assessment = assess(vehicle, telemetry)
    window = observe_window(assessment, begin_s, end_s, phase, observations)
    nominal = search_nominal(assessment, window, priors, wheel_mode, workers, settings)
    budget = Budget(settings.motions)
    budget.spend(nominal.carrier.work)
    doubts, mix = draw_all_models(nominal, priors, of_models, budget, say)
    picked = resampled(mix.draws.log_weight, draws, of_result)
    check, outliers = mix.check(picked, of_checks, settings.sampling)
    searched_rad_s = nominal.carrier.reference.limit
    prior_sigma = searched_rad_s / np.sqrt(5)  # of each component if the rate is uniform in a ball
    tree = tree_of(mix, picked, nominal.carrier.stages, prior_sigma)
    tree.attrs.update(_about(nominal, telemetry, priors, wheel_mode), seed=int(seed))

    likeliest = mix.fits[int(np.argmax(mix.probability))]
    doubts = [*likeliest.doubts, *doubts]
    speed = np.linalg.norm(mix.draws.motions.omega[picked], axis=1)
    if np.mean(speed > EDGE * searched_rad_s) > AT_EDGE:
        doubts.append(Doubt("the rates reach the limit of the search; raise max_rate_rad_s"))
    if wheels := ", ".join(wheels_of_unknown_speed(vehicle, telemetry)):
        cure = "give speed_rad_s or a speed_column, or remove a wheel that is at rest"
        doubts.append(Doubt(f"WHEEL SPEED UNKNOWN ({wheels}): assumed 0; {cure}"))
    if budget.cut:
        text = (
            f"the draws stopped at the computing budget of {settings.motions / 1e6:.3g} million motions, with an effective sample "
            f"size of {mix.draws.effective:.0f}"
        )
        doubts.append(Doubt(text, left_out=True))
    findings = _findings(tree, mix, nominal, check, outliers, doubts)
    tree.attrs.update(_verdict_attributes(tree, mix, findings, nominal, outliers))

    confirmed = bool(observations) or columns_seen(vehicle, telemetry)
    columns = COLUMNS_STATED if confirmed else COLUMNS_UNCHECKED
    row = pass_row(findings, tree, prior_sigma, columns)
    table = passes_table([row], telemetry.attrs.get("epoch_utc"))
    tree["passes"] = xr.Dataset(table, {"pass_id": [0]})
    decided = row.answers.decided
    tree.attrs["verdict"] += "; decided" if decided else f"; not decided: {row.answers.why_not}"
    if periods:
        tree["period"] = draws_by_periods(vehicle, tree, periods, workers)
    return with_units(tree)


def search_nominal(
    assessment: Assessment,
    window: Window,
    priors: Mapping[str, Any] | None = None,
    wheel_mode: str | Sequence[str] = "coast",
    workers: int | None = None,
    settings: PosteriorSettings = POSTERIOR,
) -> NominalSearch:
    """Return every motion that the readings of a window allow under the nominal model, fitted to all samples.

    The parameters are those of :func:`posterior`. One bad reading in the first window, of three samples, rules out the true motion.
    So if no motion fits all samples, and the search was short, it begins once more in other samples; the better result is kept.
    """
    stated, prior_words = with_priors(assessment, window, priors, wheel_mode)
    given_rate = bool((priors or {}).get("max_rate_rad_s"))
    reference = choose_reference(stated, settings.grid, given_rate)
    carrier = Shooting(reference.about(stated), reference, settings, workers)
    motions = search_under(carrier)
    if not carrier.explains_all and carrier.work <= settings.long_search:
        elsewhere = choose_reference(stated, settings.grid, given_rate, besides=reference.window)
        if elsewhere.sample != reference.sample:  # a short file has no others
            again = Shooting(elsewhere.about(stated), elsewhere, settings, workers)
            others = search_under(again)
            if others.cost.min() < motions.cost.min():
                carrier, motions = again, others
    fit = carrier.fit_all_samples(motions)
    return NominalSearch(assessment, window, carrier, motions, fit, prior_words)


def search_under(carrier: Shooting) -> LanderMotions:
    """Return every motion that the readings allow under the model of a carrier, by a search that begins on a grid of rates.

    The starts are kept by the carrier. A carrier that has some, those of the nominal model, begins with these: starts do not depend
    on torques.
    """
    settings = carrier.settings
    if not carrier.starts:
        carrier.announce_starts()
        carrier.starts = list(
            grid_starts(carrier.model, carrier.reference, settings.grid, carrier.workers)
        )
    starts = [
        (window, replace(carrier.model.at_centres(at.omega, at.sun), starts=at.starts))
        for window, at in carrier.starts
    ]
    watched = replace(settings.search, watch=carrier.note_window)
    # the budget ends nothing: `search` asks it before a further place only, and there is one
    return search(carrier, starts, watched, Budget(settings.motions))


def draw_all_models(
    nominal: NominalSearch,
    priors: Mapping[str, Any] | None,
    streams: Sequence[np.random.Generator],
    budget: Budget,
    say: Callable[[str], None],
) -> tuple[list[Doubt], Mixture]:
    """Return doubts, and the draws of the nominal model and of those with a constant torque.

    `streams` (6): random numbers for each of three models, and for each once more if a search under torques follows. `say` gets
    lines for the user.
    """
    # Fits under other models begin at the motions of the nominal one. Readings that fit the nominal model do not exclude a torque
    # that turns the body by a few degrees over the samples, since inertia and friction compensate it. So these models are always
    # in the draws.
    carrier, settings = nominal.carrier, nominal.carrier.settings
    torques = [carrier.under(torque) for torque in constant_torques(carrier.model, priors)]
    count = len(nominal.motions)
    say(f"fitting {count} motions under {1 + len(torques)} models, and drawing from them")
    with ThreadPoolExecutor(carrier.workers) as pool:
        fits = [nominal.fit, *pool.map(lambda torque: fit_model(torque, nominal), torques)]
    fits, doubts = draw_models(fits, nominal, streams[:3], budget)
    mix = Mixture.of(fits, settings.sampling, carrier.workers)
    left_out = any(doubt.left_out for doubt in nominal.fit.doubts)
    if not torques or left_out or nominal_explains(mix, settings):
        return doubts, mix

    # If no motion of the nominal model fits, a torque may be the cause: search under each torque from the first samples on. That is
    # not done if the first search had to leave motions out, as one of these may fit without a torque, or took too long.
    if carrier.work > settings.long_search or budget.exhausted():
        text = "solutions with a constant torque were not searched, as this would take longer than the search without"
        return [*doubts, Doubt(text, left_out=True)], mix
    say("no motion explains the readings: searching under constant torques")
    carrier.announce_torques(len(torques))
    # the budget does not count these searches: `ShootingSettings.most_search` limits each
    searched = [fit_model(torque, nominal, search_under(torque)) for torque in torques]
    fits, doubts = draw_models([fits[0], *searched], nominal, streams[3:6], budget)
    return doubts, Mixture.of(fits, settings.sampling, carrier.workers)


def fit_model(
    carrier: Shooting, nominal: NominalSearch, searched: LanderMotions | None = None
) -> ModelFit:
    """Fit motions to all samples under the model of `carrier`: those of the nominal search, and `searched` if given.

    `searched`: motions that a search under this model has left (:func:`search_under`). The motions of the nominal search include
    some that fit far worse than the best, as they may fit under this model. Unknowns of this model that the nominal model lacks
    begin at the centres of their priors.
    """
    names = [unknown.name for unknown in carrier.model.unknowns]
    # indices of the nominal model's unknowns among those of this model
    places = np.array([names.index(unknown.name) for unknown in nominal.carrier.model.unknowns])
    motions = nominal.motions.with_unknowns(places, len(names))
    if searched is not None:
        # this search has its own remarks, and notes whether it left motions out
        return carrier.fit_all_samples(LanderMotions.joined([motions, searched]))
    fit = carrier.fit_all_samples(motions)
    # without a search under this model, motions that the nominal search left out are missing here too
    return replace(fit, doubts=tuple(dict.fromkeys((*nominal.fit.doubts, *fit.doubts))))


def draw_models(
    fits: Sequence[ModelFit],
    nominal: NominalSearch,
    streams: Sequence[np.random.Generator],
    budget: Budget,
) -> tuple[list[ModelFit], list[Doubt]]:
    """Return the fits of the nominal model, the first, and of other models with enough evidence, with draws; and doubts.

    Each model is drawn with its own stream of random numbers, unless it has draws. The likeliest model gets all draws, the others
    fewer. Raises `InputError` if nothing can be drawn under the nominal model.
    """
    settings, count = nominal.carrier.settings, len(nominal.carrier.t_s)
    evidence = np.array([logsumexp(fit.log_evidence) for fit in fits])  # log, by Laplace's method
    promising = evidence > evidence.max() - settings.hopeless
    chosen = [h for h in range(len(fits)) if h == 0 or promising[h]]
    # The budget is divided before the first draw, so that results do not depend on which model is ready first. One part is left,
    # which the draws after a search under torques may use.
    most = (budget.most - budget.used) / (len(chosen) + 1) / count
    # the cost that a true motion does not exceed
    cost_limit = nominal.carrier.cost_limit(slice(0, count))

    def with_draws(h: int) -> tuple[ModelFit, Budget]:
        """Return the fit of model h with draws, and the budget spent on them, in motions over the whole stretch of samples.

        A fit that has draws already is returned as it is, with nothing spent. The likeliest model gets all draws of the settings,
        another the part `others_draws`. If even the best motion costs more than `beyond` times what a true motion may, few draws
        in two rounds are enough to say by how much the model fails.
        """
        fit, sampling, spent = fits[h], settings.sampling, Budget(most)
        if fit.draws is not None:
            return fit, spent
        part = 1.0 if evidence[h] == evidence.max() else settings.others_draws
        if fit.motions.cost.min() > settings.beyond * cost_limit:
            part, sampling = part * settings.beyond_draws, replace(sampling, rounds=2)
        sampling = replace(
            sampling, draws=int(part * sampling.draws), wanted=part * sampling.wanted
        )
        draws = sample(LanderTarget(fit.model), fit, streams[h], sampling, spent)
        return replace(fit, draws=draws), spent

    # all models at once, also on fewer cores: with a thread for each core the last of three models would run on one core of two
    with ThreadPoolExecutor(len(chosen) if nominal.carrier.workers > 1 else 1) as pool:
        results = list(pool.map(with_draws, chosen))
    possible, doubts = [], []
    for h, (fit, spent) in zip(chosen, results, strict=True):
        budget.spend(spent.used * count)
        budget.cut |= spent.cut
        if np.isfinite(fit.drawn.log_evidence):
            possible.append(fit)
        elif h == 0:
            raise _nothing_drawn(fit.model)
        elif evidence[h] > logsumexp(evidence) + np.log(LEAST_COUNTED):
            drawn = "but no motion that it allows could be drawn"
            doubts.append(Doubt(f"{fit.model.what} may explain the readings too, {drawn}"))
    return possible, doubts


def nominal_explains(mix: Mixture, settings: PosteriorSettings) -> bool:
    """Return whether the nominal model explains the readings: they are likely under it, and no other is far likelier."""
    rng = np.random.default_rng(0)
    alone = Mixture.of(mix.fits[:1], settings.sampling)
    picked = resampled(alone.draws.log_weight, settings.checked_draws, rng)
    check, _ = alone.check(picked, rng, settings.sampling)
    return bool(
        check.p > settings.explains_p
        and abs(check.noise_sigmas) < settings.explains_noise
        and mix.probability[0] > settings.explains_probability
    )


def _nothing_drawn(model: LanderModel) -> InputError:
    """Return the error to be raised if all draws of the nominal `model` have the weight zero.

    A draw has the weight zero if its body cannot exist or its rate exceeds the largest. If most of the prior describes bodies that
    cannot exist, the error advises a smaller sigma of the inertia, else a higher largest rate.
    """
    possible = np.exp(model.log_possible)  # part of the prior whose bodies can exist
    if possible < FEW_BODIES:

        def with_inertia_sigma(sigma: float) -> LanderModel:
            """Return the model in which the inertia has this relative sigma."""
            sigmas = inertia_sigma(np.array(model.vehicle.require_inertia()), sigma).ravel()
            unknowns = (
                replace(x, sigma=sigmas[x.index]) if x.kind == "inertia" else x
                for x in model.of_motion
            )
            return replace(model, of_motion=tuple(unknowns))

        enough = np.log(MOST_BODIES)
        advised = (x for x in ADVISED_SIGMAS if with_inertia_sigma(x).log_possible > enough)
        return InputError(
            "hardly any inertia within its sigma is that of a body, and none that was drawn fits the readings",
            got=f"{possible:.2g} of the prior",
            do=f"give --prior inertia={next(advised, ADVISED_SIGMAS[-1]):g}, or smaller sigmas in the vehicle file",
        )
    return InputError(
        "the motion that fits best is at the limit of what the priors allow, and no draw around it lies within",
        got=f"max_rate_rad_s {model.max_rate:.3g}",
        do=f"give --prior max_rate_rad_s={2 * model.max_rate:.2g}",
    )


def _write_line(line: str) -> None:
    """Write a line on the standard error, above any progress bar."""
    tqdm.write(f"sunspin: {line}", file=sys.stderr)


def _about(
    nominal: NominalSearch, telemetry: xr.Dataset, priors: Mapping[str, Any] | None, wheel_mode: Any
) -> dict[str, Any]:
    """Return the attributes of the result that describe its origin, telemetry, priors and search."""
    window, reference, model = nominal.window, nominal.carrier.reference, nominal.fit.model
    comments = {"comments": telemetry.attrs["comments"]} if "comments" in telemetry.attrs else {}
    mode = wheel_mode if isinstance(wheel_mode, str) else list(wheel_mode)
    t_s = window.start_s + window.obs.t_s[model.panels.present()]
    of_vehicle = nominal.assessment.vehicle.result_attributes
    return provenance("posterior", telemetry, **comments, **of_vehicle) | {
        "t_first_s": window.start_s,
        "t_last_s": float(t_s[-1]),
        "noise": float(np.median(model.panels.sigma)),
        "noise_from": window.noise_from,
        "samples": len(t_s),
        "reference_sample": reference.sample,
        "priors": json.dumps(nominal.prior_words),
        "priors_given": json.dumps({str(key): value for key, value in (priors or {}).items()}),
        "wheel_mode": json.dumps(mode),
        "max_rate_rad_s": reference.prior_max_rate,
        "searched_rate_rad_s": float(reference.limit),
        "time_sigma_s": model.panels.time_s,
    }


def _findings(
    tree: xr.DataTree,
    mix: Mixture,
    nominal: NominalSearch,
    check: PredictiveCheck,
    outliers: np.ndarray,
    doubts: Sequence[Doubt],
) -> PosteriorFindings:
    """Return the quantities that decide the verdict; `outliers` (n, p): probability of each reading to be an outlier.

    The doubt about starts is put before the other `doubts`.
    """
    solutions, panels = group(tree, "solutions"), nominal.fit.model.panels
    probability = solutions["probability"].values
    if np.any(solutions["starts"].values[probability >= LEAST_COUNTED] == 1):
        text = "a solution was reached from one start only, so others may be missing"
        doubts = [Doubt(text), *doubts]
    read = panels.present()  # (n) samples with a reading
    bright = panels.used & (panels.power > np.maximum(panels.threshold, SURELY_LIT * panels.sigma))
    # samples without a lit panel may be in the shadow of a planet, for which no panel is to blame
    sunlit = bright.any(axis=1)
    names = nominal.fit.model.vehicle.input_names
    t_s = nominal.window.start_s + nominal.window.obs.t_s
    rate, covariance = solutions["omega_B"].values, solutions["omega_cov_B"].values
    # sigma of the logarithm of the noise, zero if the noise is known
    noise_sigma = sum(unknown.sigma for unknown in panels.own if unknown.kind == "noise")
    return PosteriorFindings(
        probability=probability,
        rate=rate,
        longest_sigma=np.sqrt(np.linalg.eigvalsh(covariance)[:, -1].clip(0)),
        speed=np.sqrt((rate**2).sum(axis=1) + np.trace(covariance, axis1=1, axis2=2)),
        interval_s=float(np.median(np.diff(t_s[read]))),
        p_value=check.p,
        noise_sigmas=check.noise_sigmas,
        accused=accused_panels(names, outliers[sunlit], panels.lit[sunlit]),
        pareto_k=mix.draws.pareto_k,
        effective=mix.draws.effective,
        doubts=list(doubts),
        dark=dark_stretch(t_s[read], sunlit[read]),
        alike=alike_motions(nominal.assessment.vehicle) or one_plane(panels),
        noise_factor=float(np.exp(check.noise_sigmas * noise_sigma)),
        part=explained_part(t_s, nominal.carrier.explained),
    )


def _verdict_attributes(
    tree: xr.DataTree,
    mix: Mixture,
    findings: PosteriorFindings,
    nominal: NominalSearch,
    outliers: np.ndarray,
) -> dict[str, Any]:
    """Return the attributes of the result that belong to the verdict; `outliers` as in :func:`_findings`."""
    word, text = posterior_words(findings)
    models = [fit.model.what for fit in mix.fits]
    probability = dict(zip(models, mix.probability.tolist(), strict=True))
    likeliest = max(models, key=lambda what: probability[what])
    if likeliest != AS_STATED:
        share = f"{probability[likeliest]:.2f}"
        if findings.refused and not any(doubt.left_out for doubt in findings.doubts):
            size = nominal.prior_words["steady_torque"]  # "turns by up to 300 deg (assumed)"
            text += f"; {likeliest} that {size} does not explain the readings either"
        elif not findings.refused:
            text += f"; an alternative model fits better: {likeliest} (probability {share})"
    if word == "not explained":
        fastest = np.degrees(tree.attrs["searched_rate_rad_s"])
        text += f"; rates up to {fastest:.3g} deg/s were searched"
    return {
        "verdict": text,
        "verdict_word": word,
        "p_value": findings.p_value,
        "noise_sigmas": findings.noise_sigmas,
        "pareto_k": findings.pareto_k,
        "effective_draws": findings.effective,
        "log_evidence": mix.draws.log_evidence,
        "remarks": "; ".join(nominal.window.remarks),
        "spoilt_readings": float(outliers.sum()),
        # probabilities of the models; the variable `hypotheses` of the group `search` counts motions
        "hypotheses": json.dumps({what: round(share, 4) for what, share in probability.items()}),
    }
