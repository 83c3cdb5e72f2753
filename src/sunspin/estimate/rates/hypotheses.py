"""What else a pass of :mod:`sunspin.estimate.rates` may be: another list of terms, another body or noise, run by one function.

A hypothesis is what a fit believes. An alternative is that with one entry changed, here: a sensor left out. They are ranked by
their evidence. A sensor that is left out has readings all the same: they count as if what it sees were another at every reading,
which is so improbable that a sensor is missed as long as it agrees with the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunspin.estimate.equivalence import CLEARLY
from sunspin.estimate.rates.common_errors import Clock
from sunspin.estimate.rates.smooth import TURN_PRIOR
from sunspin.estimate.rates.state import Motion, Observations
from sunspin.estimate.terms.term import MotionTerm, Term

AS_STATED = "as stated"
"""What the hypothesis changes that believes everything."""

ANY_TURN = np.log(4 * np.pi) - 2 * np.log(np.sqrt(2 * np.pi) * TURN_PRIOR)
"""What the weak prior of an attitude without a Sun adds too much to the log evidence: two turns more than one about the Sun."""


@dataclass(frozen=True)
class Hypothesis:
    """What a fit believes: readings and errors in common, `o.terms` of all samples of a pass, those `kept` that are fitted, how the
    body moves, the clock; `what` it changes, in words, and `debt`, log density of the readings that it leaves out."""

    what: str
    o: Observations
    kept: np.ndarray
    motion: Motion
    clock: Clock | None = None
    debt: float = 0.0

    def fitted(self) -> Observations:
        """What is fitted."""
        return self.o.take(self.kept).freed()

    def beside(self, what: str, term: Term, odds: float = 0.0) -> Hypothesis:
        """The same with one more term, at log odds before the data."""
        return replace(
            self, what=what, o=replace(self.o, terms=(*self.o.terms, term)), debt=self.debt + odds
        )

    def swapped(self, old: Term, new: Term) -> Hypothesis:
        """The same with another term in the place of one."""
        return replace(self, o=self.o.swapped(old, new))

    def without(self, terms: Iterable[Term]) -> Hypothesis:
        """The same with some of its terms left out."""
        out = list(terms)
        left = replace(
            self.o,
            terms=tuple(term for term in self.o.terms if not any(term is one for one in out)),
        )
        t_s = self.o.t_s[self.kept]
        debt = sum(term.take(self.kept).freed(t_s).unrelated(t_s) for term in out)
        debt += ANY_TURN if self.o.of_sun and not left.of_sun else 0.0
        return replace(self, what=f"without the {out[0].called}", o=left, debt=self.debt + debt)


class Fit(NamedTuple):
    """What a run of a hypothesis gave: `log_weight` (K) of its modes, and whether it fits."""

    log_weight: np.ndarray
    fits: bool


class Judged(NamedTuple):
    """A hypothesis with its log evidence, and whether it fits."""

    hypothesis: Hypothesis
    log_evidence: float
    fits: bool


def ranked(
    hypotheses: Iterable[Hypothesis], run: Callable[[Hypothesis], Fit | None]
) -> list[Judged]:
    """Hypotheses of the same readings by their evidence, best first; one that finds no motion is left out."""
    found = [(one, run(one)) for one in hypotheses]
    judged = [
        Judged(one, float(np.logaddexp.reduce(fit.log_weight)) + one.debt, fit.fits)
        for one, fit in found
        if fit is not None
    ]
    return sorted(judged, key=lambda one: -one.log_evidence)


def sensors_left_out(stated: Hypothesis) -> list[Hypothesis]:
    """Each sensor left out, whose absence the others can bear: without a Sun, one must read rates or turns."""
    names = dict.fromkeys(
        term.called
        for term in stated.o.terms
        if not isinstance(term, MotionTerm) and term.present().any()
    )
    found = [
        stated.without([term for term in stated.o.terms if term.called == name]) for name in names
    ]
    return [one for one in found if one.o.of_sun or _moves(one.o)]


def _moves(o: Observations) -> bool:
    dt = float(o.t_s[1] - o.t_s[0])
    return any(np.isfinite(term.rates(0, dt, 0.0)).any() for term in o.terms)


def odd_one(judged: list[Judged]) -> Judged | None:
    """The alternative that fits where the pass as stated does not, if its evidence is clearly better; `judged`: best first."""
    stated = max(
        (one.log_evidence for one in judged if one.hypothesis.what == AS_STATED), default=-np.inf
    )
    best = next((one for one in judged if one.fits), None)
    return best if best is not None and best.log_evidence > stated + CLEARLY else None
