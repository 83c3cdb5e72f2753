"""From starts to modes: least squares over windows that grow, without copies and without what the readings rule out."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from sunspin.base.errors import InputError
from sunspin.compute.pool import worker_count
from sunspin.compute.rows import ensemble
from sunspin.dynamics.torques import NOTHING
from sunspin.estimate.effort import spend
from sunspin.estimate.posterior import cells as c
from sunspin.estimate.posterior import tilt
from sunspin.estimate.posterior.data import Readings
from sunspin.estimate.posterior.family import boxes, denser, joined, same_mode
from sunspin.estimate.posterior.fit import FITTED, Begun, Fit, Levels, OfStates, Slopes, chunk_rows
from sunspin.estimate.posterior.likelihood import SEARCH_ERROR, Likelihood
from sunspin.estimate.posterior.model import STANDING, Model, State
from sunspin.estimate.posterior.turns import rest_of
from sunspin.solve.least_squares import limit_length

GROWTH = 1.5
"""Factor by which the window grows: what is known of the phase then still carries."""

FEW = 5
"""Samples up to which one is added at a time."""

FIRST_LEVELS, LEVELS, LAST_LEVELS = ((3.0, 2), (1.0, 2)), ((3.0, 2), (1.0, 3)), ((2.0, 3), (1.0, 8))
"""(factor on the noise, steps) of least squares on the first samples, while the window grows, and on all samples."""

AGAIN_LEVELS = ((1.0, 12),)
"""Once more, with derivatives found anew, for what fits more samples than `FEW`: with inertia, friction and wheel unknown a motion
answers to a further sample by a long way along its sheet, and derivatives corrected by steps do not carry so far. Noise then takes
the misfit up, and the true motion falls behind: without these steps 1 of 10 twins at two minutes was lost."""

HASTE_LEVELS, HASTE_SLACK = ((2.0, 3), (1.0, 3)), 20.0
"""The same on all samples where it is asked which hypotheses may become modes, and by how much these may be worse than modes."""

SLACK = 10.0
"""What one or two readings that are no good add to a true motion's misfit."""

SLACK_STILL = 4.0
"""The same while inertia, friction and wheel are left as they are."""

FAR_BEYOND = 2.0
"""Times the misfit that a true motion does not exceed, from which on no motion fits and draws need not be good."""

NOT_YET = 0.5
"""What a hypothesis may be worse by, for each reading, after the steps under the wider noise."""

NOISE_SIGMAS, NOISE_MOST = 2.0, 1.5
"""Sigmas of its prior by which the noise may be larger than stated, and the logarithm of the factor that is allowed at most."""

GRID_SAMPLES, FEW_STARTS = 3, 2000
"""Samples for which the grid of starts is dense enough: neighbours are set from the next window on, or where they cost little."""

CHILDREN, MANY = 2, 5_000
"""Hypotheses to each of those whose neighbours they are, and all together, from which on derivatives are found at the latter alone:
what fits then has its own found, which takes a tenth of the runs. Where there are few, all have theirs: with derivatives of
neighbours families look wider than they are."""

LOOK = 0.6
"""rad by which a hypothesis may be wrong about the sample added next, before it is fitted to it."""

MOST_FEW, MOST = 100_000, 20_000
"""Hypotheses carried on at most, before those on one sheet are joined and after; the verdict says when there were more."""

MOST_WORK = 200_000
"""Motions times samples that are fitted to one window at most: about a minute of one core at 0.3 ms each, and of five samples
40,000 motions. Without this bound up to 750,000 motions are fitted to five samples 120 s apart."""

MOST_SEARCH, LEAST_WORK = 900_000, 30_000
"""The same of a whole search, about four minutes: a window gets at most a third of what is left, and as much of the second in any
case, so that every search ends."""

FIT_S, START_S, WINDOW_S = 0.005, 5e-5, 3e-4
"""s of one core for a motion that is fitted to five samples, with what follows, for a start, and for a unit of the volume of rates
of the first five samples; measured on Philae, samples 50 to 120 s apart. The last is good to a factor of five, and chooses only."""

LONG_S = 60.0
"""A stage that takes longer than this is announced before it begins."""

MORE = "more trial solutions than the search can follow"

MAX_RATE = "--prior max_rate_rad_s="

NO_TORQUES = "solutions with a constant torque were not searched, as this would take longer than the search without"

INCOMPLETE = (MORE, "could be searched", NO_TORQUES)
"""Words of the notes on a search that did not follow all motions that may fit."""

KEPT_ANYWAY = 100
"""Hypotheses carried on where the readings rule out all."""

SPEED_LEFT = 0.3
"""Part of its speed that a wheel has left at a reference."""

TURNS = 4
"""Turns about the Sun that are tried where torques depend on them."""

SHARED_EDGE = 0.5
"""Step of the grid over the largest rate, at most, where panels share inputs: three samples then fit motions all along a line of
rates, and with one cell for the whole ball 1 of 8 true motions was lost."""

MOST_CHOICES = 40
"""Samples looked at for the reference, evenly over those that may be it."""

DROP, MOST_MODES = 30.0, 300
"""Modes less probable than the best by exp(-30) are left out, and more than this."""


BEYOND = 40
"""Fits kept beside the modes, the best."""

SIZES_FITTED = (1, 3, 5)
"""Which of the sigmas of a steady torque fits are under, one after the other; what lies between is near enough."""

FIRST_FASTER, SPUN_UNSURE = 1.05, 0.15
"""Times the prior's largest rate, and part of what wheels hand over, beyond which a motion cannot have begun."""

MOST_SPUN = 0.6
"""Of the largest rate, what wheels may have handed over at the reference: the grid has to hold it too (at 0.8 it has ten times as
many points, which took 80 s), and first fits hold the friction that it depends on."""

INSIDE = 0.95
"""Part of the largest rate at which modes begin that lie beyond it: draws about them stay inside."""


@dataclass(frozen=True)
class Modes:
    """What was found, best first: centres, minus the log posterior (n) but for a constant, curvature (n, D, D), how many
    starts came together in each (n); `trace`: samples, hypotheses before and after, at each stage; `notes` for the verdict.

    `share` (n): under which sigma of a steady torque each was fitted, as a part of the widest. `beyond`: what fits worse than modes
    do, the best first, and the starts of each: under another model they may fit."""

    state: State
    objective: np.ndarray
    hessian: np.ndarray
    hits: np.ndarray
    trace: tuple[tuple[int, int, int], ...]
    notes: tuple[str, ...]
    share: np.ndarray = field(default_factory=lambda: np.ones(1))
    beyond: tuple[State, np.ndarray] | None = None

    @property
    def complete(self) -> bool:
        """Whether all motions that may fit were followed."""
        return not any(word in note for note in self.notes for word in INCOMPLETE)


def within(modes: Modes, max_rate: float) -> Modes:
    """The modes drawn back into the ball of rates where they all lie outside: no draw about them would count."""
    if np.any(np.linalg.norm(modes.state.omega, axis=1) <= max_rate):
        return modes
    state = replace(modes.state, omega=limit_length(modes.state.omega, INSIDE * max_rate))
    return replace(
        modes,
        state=state,
        notes=(*modes.notes, "the readings need faster rates than the prior allows"),
    )


@dataclass(frozen=True)
class Plan:
    """Where the search starts: sample taken as the reference, samples tried, grid step, directions, largest rate there and at the
    first sample, and that of the prior, rad/s."""

    anchor: int
    tried: np.ndarray
    edge: float
    suns: np.ndarray
    limit: float
    fastest: float = np.inf
    given: float = np.inf


def plan(model: Model, data: Readings, scale: float) -> Plan:
    """The reference from which the search is the shortest, of those samples at which no wheel can have stopped.

    Starts take time, and motions that fit the first `FEW` samples: about as many as directions that these allow, times the volume
    of rates in units of the time that they reach from the reference, which is half as far from the middle of a file.
    """
    lit = np.flatnonzero(data.lit.any(axis=1))
    choices = [a for a in lit if _runs_on(model, float(data.t_s[a]))] or [lit[0]]
    choices = [
        a for a in choices if _spun_up(model, float(data.t_s[a])) <= MOST_SPUN * model.max_rate
    ] or choices[:1]
    choices = [
        choices[i]
        for i in np.unique(np.linspace(0, len(choices) - 1, MOST_CHOICES).round().astype(int))
    ]
    suns = {
        i: c.sun_candidates(model, data, scale, i)
        for i in sorted({int(i) for a in choices for i in _nearest(data, a, FEW)})
    }
    tried = []
    for a in choices:
        around, window = _neighbours(data, a), _nearest(data, a, FEW)
        edge = c.grid_edge(data.t_s[around] - data.t_s[a])
        edge = min(edge, SHARED_EDGE * model.max_rate) if model.vehicle.channels else edge
        reach, after = float(np.abs(data.t_s[window] - data.t_s[a]).max()), float(data.t_s[a])
        took = START_S * len(suns[int(a)]) * c.cell_count(ball(model, after), edge)
        took += (
            WINDOW_S
            * (fastest(model, after) * reach) ** 3
            * np.prod([len(suns[int(i)]) for i in window], dtype=float)
        )
        tried.append((took, int(a), around, edge, suns[int(a)]))
    _, anchor, around, edge, found = min(tried, key=lambda one: one[0])
    return Plan(
        anchor,
        around,
        edge,
        found,
        min(model.max_rate, c.largest_ball(c.MAX_CELLS / len(found), edge)),
    )


def require_few(model: Model, data: Readings, scale: float) -> Plan:
    """The plan of a search; refused, with the number of starts and the limit, where the caller gave a ball of rates too large."""
    chosen = plan(model, data, scale)
    asked = _starts(model, chosen)
    if asked <= c.MAX_STARTS:
        return chosen
    smaller = model
    while (
        _starts(smaller, chosen) > c.MAX_STARTS
    ):  # with a smaller ball another reference may be the best one
        smaller = replace(
            smaller,
            max_rate=float(
                f"{0.99 * c.largest_ball(c.MAX_STARTS / len(chosen.suns), chosen.edge):.3g}"
            ),
        )
        chosen = plan(smaller, data, scale)
    what = f"max_rate_rad_s asks for {asked:.2g} starts, and {c.MAX_STARTS:.0e} at most can be tried in an hour"
    raise InputError(
        what,
        got=f"{model.max_rate:g}",
        do=f"with these samples give {smaller.max_rate:.3g} at most",
    )


def _starts(model: Model, chosen: Plan) -> float:
    return c.cell_count(model.max_rate, chosen.edge) * len(chosen.suns)


def _runs_on(model: Model, after_s: float) -> bool:
    """Whether every wheel still has a good part of its speed then, so that motions can be followed back through it."""
    none = np.zeros((1, len(model.unknowns)))
    there = np.abs(replace(model, after_s=after_s).wheel_speeds(none)[0])
    return after_s == 0.0 or bool(
        np.all(
            (there > SPEED_LEFT * np.abs(model.wheel_speeds(none)[0]))
            | (model.wheel_mode == "hold")
        )
    )


def ball(model: Model, after_s: float) -> float:
    """A largest rate at a reference that holds what comes of the prior's ball at the first sample.

    Wheels that run down hand over their momentum, and unequal moments let |omega| vary: uniform in a ball stays uniform, as the
    motion keeps volumes in rate space, but its edge moves. A truth beyond the edge would be lost, and a wrong motion found.
    """
    if after_s == 0.0:
        return model.max_rate
    moments = np.linalg.eigvalsh(model.vehicle.require_inertia())
    return model.max_rate * float(
        np.clip(np.sqrt(moments[-1] / moments[0]), 1.05, 1.5)
    ) + 1.3 * _spun_up(model, after_s)


def fastest(model: Model, after_s: float) -> float:
    """An angular speed at the first sample, rad/s, that no motion of the prior's ball exceeds, as computed back from a reference.

    The ball that holds all that comes of the prior's at the reference is far larger than it, for Philae 7 min later four times, and
    most motions in it began beyond the largest rate. Those beyond it by 5 %, and by three sigmas of what friction is not known by,
    are left out.
    """
    return FIRST_FASTER * model.max_rate + SPUN_UNSURE * _spun_up(model, after_s)


def _spun_up(model: Model, after_s: float) -> float:
    """Rate (rad/s) that wheels running down hand over to the body in that time, about the axis of the least moment."""
    none = np.zeros((1, len(model.unknowns)))
    change = np.abs(replace(model, after_s=after_s).wheel_speeds(none) - model.wheel_speeds(none))[
        0
    ]
    spins = float(np.sum(change * [w.inertia_kg_m2 for w in model.vehicle.wheels]))
    return spins / float(np.linalg.eigvalsh(model.vehicle.require_inertia())[0])


def at_reference(model: Model, chosen: Plan, data: Readings) -> tuple[Model, Plan]:
    """Model and plan with the plan's sample as the reference, and a ball of rates there that holds what comes of the prior's."""
    after = float(data.t_s[chosen.anchor])
    wider = ball(model, after)
    limit = chosen.limit if chosen.limit < model.max_rate else wider
    chosen = replace(chosen, limit=limit, fastest=fastest(model, after), given=model.max_rate)
    return replace(model, after_s=after, max_rate=wider), chosen


def _nearest(data: Readings, a: int, count: int) -> np.ndarray:
    """The samples (count) nearest in time to sample `a`, itself among them."""
    return np.sort(np.argsort(np.abs(data.t_s - data.t_s[a]), kind="stable")[:count])


def _neighbours(data: Readings, a: int) -> np.ndarray:
    """The sample before and the one after, or at an end the two next; dark ones count too, as they bound the direction."""
    low = 1 if a > 0 else 0
    around = (
        np.array([a - 1, a + 1])
        if low and a + 1 < len(data)
        else np.array([a + 1, a + 2] if a == 0 else [a - 2, a - 1])
    )
    return around[(around >= 0) & (around < len(data))]


@dataclass(frozen=True)
class Look(OfStates):
    """Row -> whether a sample allows a hypothesis, give or take `LOOK` rad, and so does the prior: at most `fastest` rad/s at the
    first sample."""

    scale: float
    fastest: float
    outputs: ClassVar[Mapping[str, Any]] = {"allowed": ("bool", ())}

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        model, state = self.likelihood.model, self.state.take(index)
        seen = self.likelihood.predict(state).sun
        allowed = c.shortfall(model, self.likelihood.data, seen, LOOK, self.scale) <= c.LIMIT
        allowed[allowed] = c.first_speed(model, state.take(allowed)) <= self.fastest
        return {"allowed": allowed}


class Search:
    """One enumeration: keeps store, workers and bar for its stages."""

    def __init__(self, workers: int | None, store: Path | None, progress: bool) -> None:
        self.workers, self.store, self.progress = workers, store, progress
        self.stage = 0
        self.said: set[str] = set()
        self.fitted = 0  # motions times samples

    def run(self, function: Any, label: str, chunk: int) -> dict[str, np.ndarray]:
        """All rows of a function, kept in a folder of its own."""
        store = (
            None
            if self.store is None
            else self.store / f"{self.stage:02d}-{label.replace(' ', '-')}"
        )
        self.stage += 1
        if isinstance(function, OfStates | Fit):
            runs = FITTED if isinstance(function, Fit) else 1
            spend(runs * function.n_rows * len(function.likelihood.data))
        return ensemble(
            function,
            workers=self.workers,
            chunk=chunk,
            store=store,
            progress=self.progress,
            label=label,
        )

    def starts(
        self, model: Model, data: Readings, chosen: Plan, scale: float
    ) -> tuple[State, np.ndarray]:
        """Starts around the reference; `data` counts time from it."""
        if (took := START_S * c.cell_count(chosen.limit, chosen.edge) * len(chosen.suns)) > LONG_S:
            smaller = chosen.given * (LONG_S / took) ** (1 / 3)
            self._say(
                f"looking for starts takes about {took / 60:.1f} min; with {MAX_RATE}{smaller:.2g} it takes about one"
            )
        near = data.take(chosen.tried)
        tried = replace(near, others=())
        # torques hardly move a body in three samples, and the frame of H in which the grid's motions are kept would move too
        # and without unknowns all motions are of the vehicle's own body: one for all runs faster than one for each
        own = tuple(x for x in model.unknowns if x.kind == "wheel_speed")
        free = replace(model, max_rate=chosen.limit, acting=NOTHING, unknowns=own)
        grid = c.Attitudes(free, tried.t_s, chosen.edge)
        turn = self.run(grid, "grid of rates", 8192)["turn"]
        here = data.value[chosen.anchor], data.used[chosen.anchor]
        cells = c.Starts(grid, turn, tried, *here, chosen.suns, scale)
        state, hits = cells.found(worker_count(self.workers))
        state = replace(state, u=np.zeros((len(state), len(model.unknowns))))
        slow = c.first_speed(model, state) <= chosen.fastest
        return state.take(slow), hits[slow]

    def fit(
        self,
        likelihood: Likelihood,
        state: State,
        levels: Levels,
        label: str,
        every: bool = False,
        **options: Any,
    ) -> dict[str, np.ndarray]:
        """Least squares from each state; from several turns about the Sun where it depends on that: `every` one, or the best."""
        turns = _turned(likelihood.model, state)
        self.fitted += len(turns) * len(state) * len(likelihood.data)
        found = self.run(
            Fit(likelihood, State.joined(turns), levels, **options), label, chunk_rows(likelihood)
        )
        if every or len(turns) == 1:
            return found
        cost = found["cost"].reshape(len(turns), len(state))
        best = np.where(np.isfinite(cost), cost, np.inf).argmin(axis=0) * len(state) + np.arange(
            len(state)
        )
        return {name: values[best] for name, values in found.items()}

    def modes(self, model: Model, data: Readings, chosen: Plan, scale: float) -> Modes:
        """All modes; `model` and `data` have the plan's sample as the reference.

        While the window grows the panels' own turns are left alone and counted as noise: there would be as many as readings. The
        turn of all panels stays an unknown: a few samples fit a motion in turned axes, too, and as noise it would let through many
        more motions than there are. Starts and looks ahead have room enough for turns.
        """
        whole, wide = (
            Likelihood(model, data),
            replace(data, sigma=tilt.spread(data.sigma, model.vehicle, model.unknowns, scale)),
        )
        model, kept = standing(model, (tilt.KIND,))
        # few samples tell nothing of the body's own constants, and motions of one body run faster than one body for each
        few, held = standing(model, tuple({x.kind for x in model.unknowns} - {*STANDING, "turn"}))
        state, hits = self.starts(few, data, chosen, scale)
        notes: list[str] = []
        if chosen.limit < model.max_rate * (1 - 1e-9):
            notes.append(f"only rates up to {np.degrees(chosen.limit):.3g} deg/s could be searched")
        if not len(state):
            state = _anything(few, chosen)
            hits = np.ones(len(state), dtype=np.int64)
            notes.append("no rate fits the first samples")
        used = np.sort(np.append(chosen.tried, chosen.anchor))
        trace, first, beside, origin = [], True, np.zeros(len(state)), np.arange(len(state))
        parents = state
        while True:
            part, still = wide.take(used), len(used) < FEW
            now = few if still else model
            if len(now.unknowns) > state.u.shape[1]:
                state, parents = (_among(x, now, held) for x in (state, parents))
            likelihood = Likelihood(now, part)
            levels, label = FIRST_LEVELS if first else LEVELS, f"{len(used)} samples"
            limit = likeliest(likelihood, still)
            hopeless = limit + expected(part) * (np.log(levels[0][0]) + NOT_YET)
            begun = self._begun(likelihood, parents, origin, still)
            fitted = self.fit(
                likelihood,
                state,
                levels,
                label,
                still=still,
                normal=True,
                hopeless=hopeless,
                begun=begun,
                promising=limit + SLACK_STILL,
            )
            following = _grown(data, used)
            reach = float(np.abs(data.t_s[following]).max())
            state = State(fitted["omega"], fitted["sun"], fitted["u"])
            keep, hits, note = _thinned(state, fitted["cost"], hits, reach, limit)
            notes += [f"{note} ({len(used)} samples)"] if note else []
            before = len(state)
            state, normal, beside, first = (
                state.take(keep),
                fitted["normal"][keep],
                beside[keep],
                False,
            )
            if not still:
                state, normal, hits, beside, note = self._one_each(
                    likelihood, state, normal, hits, beside, label
                )
                notes += [f"{note} ({len(used)} samples)"] if note else []
            trace.append((len(used), before, len(state)))
            if len(following) == len(used):
                state = _among(state, model, held) if still else state
                return self._with_images(
                    whole, self._last(whole, _widened(state, whole.model, kept), hits, trace, notes)
                )
            parents, origin = state, np.arange(len(state))
            if len(used) > GRID_SAMPLES or len(state) <= FEW_STARTS:
                state, hits, beside, origin = denser(
                    state, normal, hits, beside, reach, model.max_rate
                )
            keep = self._looked(
                now, data.take(np.setdiff1d(following, used)), state, scale, chosen.fastest
            )
            keep, note = self._followed(
                np.flatnonzero(keep) if keep.any() else np.arange(len(state)),
                len(following),
                chosen,
            )
            notes += [f"{note} ({len(following)} samples)"] if note else []
            state, hits, beside, origin = state.take(keep), hits[keep], beside[keep], origin[keep]
            used = following

    def _followed(self, keep: np.ndarray, samples: int, chosen: Plan) -> tuple[np.ndarray, str]:
        """Which motions are fitted to a window of so many samples, and a remark where not all are. What takes long, or is left out,
        is said before it begins, with what would help."""
        most = min(MOST_WORK, max(MOST_SEARCH - self.fitted, LEAST_WORK) // 3)
        some, note = _at_most(most // samples, len(keep))
        took = FIT_S * len(some) * samples / FEW
        if note:
            smaller = chosen.given * (len(some) / len(keep)) ** (1 / 3)
            self._say(
                f"{len(keep)} motions may fit {samples} samples; {len(some)} of them are followed, which takes about "
                f"{took / 60:.1f} min, and the search will not be complete; with {MAX_RATE}{smaller:.2g} about all of "
                "them would be followed"
            )
        elif samples == FEW and took > LONG_S:
            self._say(
                f"{len(keep)} motions may fit {samples} samples; following them takes about {took / 60:.1f} min, and in "
                f"proportion to the cube of {MAX_RATE.rstrip('=')} less"
            )
        return keep[some], note

    def _say(self, text: str) -> None:
        """Tell whoever waits; once for each text."""
        if text not in self.said:
            self.said.add(text)
            logging.getLogger("sunspin").warning("sunspin: %s", text)

    def _one_each(
        self,
        likelihood: Likelihood,
        state: State,
        normal: np.ndarray,
        hits: np.ndarray,
        beside: np.ndarray,
        label: str,
    ) -> tuple[State, np.ndarray, np.ndarray, np.ndarray, str]:
        """Hypotheses (best first) with what goes with them, one for each sheet, and a remark where not all are followed."""
        if len(likelihood.data) > FEW:
            first, hits = joined(
                state, normal, hits
            )  # most are copies already, and a fit to the end takes as long as the first
            state, beside = state.take(first), beside[first]
            found = self.fit(likelihood, state, AGAIN_LEVELS, f"{label} again", normal=True)
            order = np.argsort(found["cost"], kind="stable")
            state = State(found["omega"], found["sun"], found["u"]).take(order)
            normal, hits, beside = found["normal"][order], hits[order], beside[order]
        only, hits = joined(state, normal, hits)
        some, note = _at_most(MOST, len(only))
        return state.take(only[some]), normal[only[some]], hits[some], beside[only[some]], note

    def _begun(
        self, likelihood: Likelihood, parents: State, origin: np.ndarray, still: bool
    ) -> Begun | None:
        """Derivatives to begin with at many neighbours of far fewer `parents`, `origin` (n): found at these."""
        if len(origin) < max(CHILDREN * len(parents), MANY) or likelihood.model.turned:
            return None
        found = self.run(Slopes(likelihood, parents, still), "derivatives", chunk_rows(likelihood))
        return Begun(parents.take(origin), found["moves"][origin], found["seen"][origin])

    def _looked(
        self, model: Model, coming: Readings, state: State, scale: float, limit_rad_s: float
    ) -> np.ndarray:
        """Which hypotheses (n) the nearest of the coming samples allows; one run each, where a fit takes fifty."""
        nearest = coming.take(np.array([np.argmin(np.abs(coming.t_s))]))
        look = Look(
            Likelihood(model, replace(nearest, others=()), c.TRIAL_ERROR), state, scale, limit_rad_s
        )
        return self.run(look, "looking ahead", 8192)["allowed"]

    def _with_images(self, likelihood: Likelihood, found: Modes) -> Modes:
        """The modes and their images under what changes no reading of panels on shared inputs: the search may miss some."""
        images, state = likelihood.response.symmetries, found.state
        if len(images) == 1:
            return found
        turned = [  # rates are axial vectors
            State(np.linalg.det(x) * (state.omega @ x.T), state.sun @ x.T, state.u) for x in images
        ]
        every = State.joined(turned)
        return self._last(
            likelihood,
            every,
            np.tile(found.hits, len(images)),
            list(found.trace),
            list(found.notes),
        )

    def _last(
        self, likelihood: Likelihood, state: State, hits: np.ndarray, trace: list, notes: list[str]
    ) -> Modes:
        if likelihood.model.frame:
            return self.refined(likelihood, state, hits, trace, notes)
        return distinct(*self._curved(likelihood, state, hits), trace, notes)

    def _curved(
        self, likelihood: Likelihood, state: State, hits: np.ndarray, levels: Levels = LAST_LEVELS
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Fits to all samples with their curvatures, and how many starts came together in each."""
        found = self.fit(
            replace(likelihood, direction_error=1e-6),
            state,
            levels,
            "all samples",
            every=True,
            curved=True,
        )
        found["share"] = np.full(len(found["cost"]), likelihood.model.share)
        return found, np.tile(hits, len(found["cost"]) // len(hits))

    def refined(
        self, likelihood: Likelihood, state: State, hits: np.ndarray, trace: list, notes: list[str]
    ) -> Modes:
        """The modes under another model than the one under which states were found: with a steady torque, for each of its sizes."""
        if not likelihood.model.frame:
            return distinct(*self._curved(likelihood, state, hits), trace, notes)
        parts, shares = [], likelihood.model.shares
        fitted = list(dict.fromkeys(shares[min(i, len(shares) - 1)] for i in SIZES_FITTED))
        state, hits = self._hopeful(likelihood, state, hits, fitted[-1])
        for share in reversed(fitted):
            sized = replace(likelihood, model=replace(likelihood.model, share=share))
            found, starts = self._curved(sized, state, hits, LAST_LEVELS[1:])
            state = State(found["omega"], found["sun"], found["u"]).take(slice(len(state)))
            found["cost"] += 3 * np.log(
                share
            )  # the prior's height: a small torque is no wonder where small ones are expected
            parts.append((found, starts))
        every = {name: np.concatenate([found[name] for found, _ in parts]) for name in parts[0][0]}
        return distinct(
            every, np.concatenate([starts for _, starts in parts]), trace, notes, len(parts)
        )

    def _hopeful(
        self, likelihood: Likelihood, state: State, hits: np.ndarray, share: float
    ) -> tuple[State, np.ndarray]:
        """The states that may become modes, fitted in haste under one sigma of a steady torque, and the starts that led to each."""
        sized = replace(
            likelihood, direction_error=SEARCH_ERROR, model=replace(likelihood.model, share=share)
        )
        found = self.fit(sized, state, HASTE_LEVELS, "all samples in haste")
        keep = found["cost"] < found["cost"].min() + DROP + HASTE_SLACK
        return State(found["omega"], found["sun"], found["u"]).take(keep), hits[keep]


def distinct(
    found: dict[str, np.ndarray], hits: np.ndarray, trace: list, notes: list[str], times: int = 1
) -> Modes:
    """The modes among fits to all samples, copies joined; `times`: how often each start is among these."""
    order = np.argsort(found["cost"], kind="stable")
    order = order[np.isfinite(found["cost"][order])] if np.isfinite(found["cost"]).any() else order
    good = found["cost"][order] < found["cost"][order[0]] + DROP
    state, cost, hessian = (
        State(found["omega"], found["sun"], found["u"]),
        found["cost"],
        found["hessian"],
    )
    kept: list[int] = []
    count: list[int] = []
    for i in order[good]:
        near = same_mode(state, hessian, int(i), kept)
        if near is not None:
            count[near] += int(hits[i])
        elif len(kept) < MOST_MODES:
            kept.append(int(i))
            count.append(int(hits[i]))
        elif not any("modes" in note for note in notes):
            notes.append(f"more than {MOST_MODES} modes")
    far = order[~good][:BEYOND]
    index, trace = (
        np.array(kept),
        [*trace, (int(trace[-1][0]) if trace else 0, len(cost), len(kept))],
    )
    starts = -(-np.array(count) // times)
    return Modes(
        state.take(index),
        cost[index],
        hessian[index],
        starts,
        tuple(trace),
        tuple(notes),
        found["share"][index],
        (state.take(far), hits[far]),
    )


def _turned(model: Model, state: State) -> list[State]:
    """The states with each of the turns about the Sun to be tried; as they are where nothing depends on it."""
    if not model.turned:
        return [state]
    place = model.where("turn")[0]
    step = 2 * np.pi / TURNS / model.unknowns[place].sigma * np.eye(len(model.unknowns))[place]
    return [replace(state, u=state.u + i * step) for i in range(TURNS)]


def standing(model: Model, kinds: tuple[str, ...] = tilt.KINDS) -> tuple[Model, np.ndarray]:
    """The model without turns of the panels of these kinds, and the places (k) in u of the unknowns that are left."""
    kept = rest_of(model, kinds)
    return (
        model
        if len(kept) == len(model.unknowns)
        else replace(model, unknowns=tuple(model.unknowns[i] for i in kept))
    ), kept


def _among(state: State, model: Model, places: np.ndarray) -> State:
    """States with u (n, k) as those of a model that has their unknowns at `places` (k), the others at their centres."""
    u = np.zeros((len(state), len(model.unknowns)))
    u[:, places] = state.u
    return replace(state, u=u)


def _widened(state: State, model: Model, kept: np.ndarray) -> State:
    """States of `standing` as those of the model: what it left out as drawn, under the noise that is stated."""
    if len(kept) == len(model.unknowns):
        return state
    made = _among(state, model, kept)
    made.u[:, model.where("noise")] = 0.0
    return made


def _anything(model: Model, chosen: Plan) -> State:
    """Starts where there is no hope: rest, and turns about the axes."""
    rates = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)]) * min(
        0.3, 0.5 * model.max_rate
    )
    suns = np.tile(chosen.suns[0], (len(rates), 1))
    return State(rates + 1e-4, suns, np.zeros((len(rates), len(model.unknowns))))


def _grown(data: Readings, used: np.ndarray) -> np.ndarray:
    """The samples of the next window: one more while there are few, then all within a longer time."""
    distance = np.abs(data.t_s)
    rest = np.setdiff1d(np.arange(len(data)), used)
    if not len(rest):
        return used
    nearest = rest[np.argmin(distance[rest])]
    if len(used) < FEW:
        return np.sort(np.append(used, nearest))
    half = max(GROWTH * distance[used].max(), distance[nearest])
    return np.union1d(used, np.flatnonzero(distance <= half * (1 + 1e-9)))


def expected(data: Readings) -> float:
    """Numbers that a motion must explain: lit readings and other observations."""
    return float(data.lit.sum() + sum(o.value.size for o in data.others))


def likeliest(likelihood: Likelihood, still: bool = False) -> float:
    """The misfit that a true motion does not exceed.

    Half a unit for each number, and what noise larger than stated, three sigmas of chance and spoilt readings may add: these have
    nothing to do with each other, so their squares add.
    """
    model, n = likelihood.model, expected(likelihood.data)
    noisy = min(
        NOISE_SIGMAS * sum(model.unknowns[i].sigma for i in model.where("noise")), NOISE_MOST
    )
    return (
        0.5 * n
        + float(np.sqrt((noisy * n) ** 2 + 4.5 * n + SLACK**2))
        + (SLACK_STILL if still else 0.0)
    )


def beyond_all(likelihood: Likelihood, modes: Modes) -> bool:
    """Whether even the best motion is so far from the readings that draws about it need not be good: they say by how much."""
    return float(modes.objective[0]) > FAR_BEYOND * likeliest(likelihood)


def _thinned(
    state: State, cost: np.ndarray, hits: np.ndarray, reach_s: float, limit: float
) -> tuple[np.ndarray, np.ndarray, str]:
    """Which hypotheses go on, how many starts each stands for, and a remark where that is not all that should."""
    order = np.argsort(cost, kind="stable")
    order = order[np.isfinite(cost[order])]
    possible = order[cost[order] <= min(limit, cost[order].min(initial=np.inf) + DROP + SLACK)]
    note = ""
    if not len(possible):
        possible, note = order[:KEPT_ANYWAY], "no motion is within the noise"
    _, first, inverse = np.unique(
        boxes(state.take(possible), reach_s), axis=0, return_index=True, return_inverse=True
    )
    counts = np.bincount(inverse.ravel(), weights=hits[possible]).astype(np.int64)
    rank = np.argsort(first, kind="stable")  # best first
    some, more = _at_most(MOST_FEW, len(rank))
    return possible[first[rank[some]]], counts[rank[some]], more or note


def _at_most(most: int, count: int) -> tuple[np.ndarray, str]:
    """Which of `count` hypotheses, best first, are followed, and the remark where these are not all: evenly by how well they fit,
    as all of a line fits well, and its ends are wanted too."""
    if count <= most:
        return np.arange(count), ""
    return np.unique(np.linspace(0, count - 1, most).round().astype(int)), MORE
