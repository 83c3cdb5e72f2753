"""The verdict of a posterior: its word and sentence, and the row of the table of passes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sunspin.estimate.lander.motions import Doubt
from sunspin.estimate.lander.tree import LEAST_COUNTED, TOO_FEW, group
from sunspin.estimate.terms.panels import blind_axis
from sunspin.estimate.terms.powers import PanelPowers
from sunspin.estimate.verdict import NARROWER, SPEEDS, UPPER, Answers, PassRow, Speed, drawn_speeds

NOT_EXPLAINED = 0.002
"""p-value of the predictive check below which no motion explains the readings."""

NOISE_LIMIT = 3.5
"""Sigmas of its prior by which the noise may be off; beyond, no motion explains the readings."""

TAIL_LIMIT, EFFECTIVE_LIMIT = 0.55, 700.0
"""Pareto index k above which, and number of effective draws below which, draws are approximate."""

UNIQUE = 0.99
"""Least probability of a solution that is unique."""

LINE_RAD_S, LINE_SOLUTIONS = 0.15, 25
"""Solutions form a line if one has a larger sigma than the first, along its longest axis, or if they are as many as the second."""

ACCUSED_SHARE, ACCUSED_LEAST = 0.4, 3
"""A panel is named if it has at least so many outliers, and they are more than this part of its lit readings."""

DARK_RUN = 3
"""As many samples in a row without a lit panel may be in the shadow of a planet, which no motion explains."""

EXPLAINED_PART = 0.5
"""Least part of the samples that motions must explain to be named, if none explains all. In 24 files with exchanged columns or a
wheel that stands still they explain 3 to 7 of 16; in a right one, in which the search lost the true motion, 31 of 40."""


@dataclass(frozen=True)
class PosteriorFindings:
    """Quantities that decide the verdict.

    Of each solution (r), by falling probability: `probability`, `rate` (r, 3), `longest_sigma` of the rate over all directions, and
    the root mean square `speed`, rad/s. `interval_s`: median time between samples; `p_value`, `noise_sigmas`: of the predictive
    check; `accused`: sentences on panels with many outliers; `pareto_k`, `effective`: Pareto index and effective sample size of the
    draws; `doubts`: on search and draws; `dark`: when no panel was lit, in words, or empty; `alike`: which solutions panels on
    shared inputs cannot distinguish, in words, or empty; `noise_factor`: noise over the assumed one; `part`: which samples motions
    explain, in words, if not all (:func:`explained_part`).
    """

    probability: np.ndarray
    rate: np.ndarray
    longest_sigma: np.ndarray
    speed: np.ndarray
    interval_s: float
    p_value: float
    noise_sigmas: float
    accused: list[str]
    pareto_k: float
    effective: float
    doubts: list[Doubt]
    dark: str
    alike: str = ""
    noise_factor: float = 1.0
    part: str = ""

    @property
    def counted(self) -> np.ndarray:
        """Return the indices of the solutions that are probable enough to count (:data:`LEAST_COUNTED`)."""
        return np.flatnonzero(self.probability >= LEAST_COUNTED)

    @property
    def approximate(self) -> list[str]:
        """Return a sentence in a list that says that the draws are approximate; an empty list if they are good."""
        if self.pareto_k <= TAIL_LIMIT and self.effective >= EFFECTIVE_LIMIT:
            return []
        size = f"effective sample size only {self.effective:.0f} (Pareto k {self.pareto_k:.2f})"
        return [f"{size}: errors and probabilities are approximate"]

    @property
    def is_line(self) -> bool:
        """Return whether the solutions are a line rather than points."""
        longest = self.longest_sigma[self.counted].max(initial=0.0)
        return bool(len(self.counted) >= LINE_SOLUTIONS or longest > LINE_RAD_S)

    @property
    def unique(self) -> bool:
        """Return whether a single solution counts, and is no line."""
        alone = len(self.counted) == 1 and self.probability[0] >= UNIQUE
        return bool(alone and not self.is_line)

    @property
    def refused(self) -> bool:
        """Return whether no motion explains the readings: by the predictive check, or by a noise far from the stated one."""
        return self.p_value < NOT_EXPLAINED or abs(self.noise_sigmas) > NOISE_LIMIT


def posterior_words(findings: PosteriorFindings) -> tuple[str, str]:
    """Return the word of the verdict (unique, aliases, line, not explained, not sure) and its sentence."""
    doubts = [doubt.text for doubt in findings.doubts]
    # if motions explain most of the samples, the motion may change after them, or the search has lost the true one there
    if findings.refused and (findings.part or any(doubt.left_out for doubt in findings.doubts)):
        part = [findings.part] if findings.part else []
        text = "; ".join([*doubts, "none of the solutions searched fits", *part])
        return "not sure", f"not sure: {text}{_eclipse_text(findings)}"
    if findings.refused:
        return "not explained", _not_explained(findings)
    # symmetric solutions are fitted too: of a unique solution they do not fit, because inertia or wheels exclude them
    alike = [findings.alike] if findings.alike and not findings.unique else []
    text = "; ".join([_solutions_text(findings), *findings.accused, *alike])
    if doubts := [*doubts, *findings.approximate]:
        text = f"not sure: {'; '.join(doubts)}; result so far: {text}"
        return "not sure", text + _eclipse_text(findings)
    word = "line" if findings.is_line else "unique" if findings.unique else "aliases"
    return word, text


def _solutions_text(findings: PosteriorFindings) -> str:
    """Return in words how many solutions there are, and the speed of the likeliest."""
    counted, rate = findings.counted, findings.rate
    best = f"{np.degrees(findings.speed[0]):.3g} deg/s"
    likeliest = findings.probability[0]
    if findings.is_line:
        between = float(np.ptp(rate[counted], axis=0).max())
        extent = np.degrees(max(2 * float(findings.longest_sigma[counted].max()), between))
        return f"a line of solutions over {extent:.2g} deg/s fits equally well; the data do not select one"
    if findings.unique:
        return f"unique: a single solution, with an angular speed of {best}, fits the readings"
    if len(counted) < 2:
        others = int((findings.probability > 0).sum()) - 1
        rest = f", {others} others have the rest" if others else ""
        return f"several solutions: the likeliest, at {best}, has {likeliest:.1%} of the probability{rest}"
    distance = np.linalg.norm(rate[counted][:, None] - rate[counted][None], axis=-1)
    to_nearest = np.min(distance + np.diag(np.full(len(counted), np.inf)), axis=1)
    gap = np.degrees(float(np.median(to_nearest)))
    revolution = 360 / findings.interval_s  # deg/s
    return (
        f"{len(counted)} aliases, {gap:.3g} deg/s apart, fit equally well; the likeliest, at {best}, has {likeliest:.0%} of the "
        f"probability (one extra revolution between samples would be {revolution:.3g} deg/s)"
    )


def _not_explained(findings: PosteriorFindings) -> str:
    """Return in words that no solution fits, by how much, and what may be the cause."""
    text = f"not explained: no solution fits; residuals as large as these have a probability of {findings.p_value:.2g}"
    if abs(findings.noise_sigmas) > NOISE_LIMIT:
        side = "more" if findings.noise_sigmas > 0 else "less"
        size = f"{findings.noise_sigmas:+.1f} sigma, {findings.noise_factor:.2g} times"
        text = (
            f"not explained: no solution fits unless the noise is far {side} than assumed ({size})"
        )
    text = "; ".join([text, *findings.accused, *(doubt.text for doubt in findings.doubts)])
    if findings.dark:
        return text + _eclipse_text(findings)
    wheels = "the wheels (--wheel-mode, if a motor holds or brakes them)"
    return f"{text}. Check the vehicle file, the time window, {wheels}, and for shaded or failed panels"


def _eclipse_text(findings: PosteriorFindings) -> str:
    """Return in words how to leave out an eclipse, if several samples in a row have no lit panel; else an empty text.

    Residuals alone do not refuse a window with an eclipse: with six of 15 samples in the shadow, many readings counted as outliers,
    and residuals as large had a probability of 1 %.
    """
    if not findings.dark:
        return ""
    cure = "exclude it with --from and --to (begin_s, end_s)"
    return f"; {findings.dark}. If this is an eclipse, {cure}"


def dark_stretch(t_s: np.ndarray, lit: np.ndarray) -> str:
    """Return in words the longest time without a lit panel, if it has :data:`DARK_RUN` samples or more; else an empty text.

    `t_s` (n) from the epoch; `lit` (n): whether any panel was lit.
    """
    # A lit sample is added at either end. So changes are, in turn, the first sample of a dark stretch and the one after its last.
    changes = np.flatnonzero(np.diff(np.concatenate([[True], lit, [True]]).astype(int)))
    begin, end = changes[::2], changes[1::2]
    if not len(begin) or (count := int((end - begin).max())) < DARK_RUN:
        return ""
    k = int(np.argmax(end - begin))
    return f"no panel lit from {t_s[begin[k]]:.6g} to {t_s[end[k] - 1]:.6g} s ({count} samples)"


def explained_part(t_s: np.ndarray, window: slice) -> str:
    """Return in words which samples motions explain, and what to do; empty if all, or less than `EXPLAINED_PART` of them.

    `t_s` (n): times of the samples from the epoch, s; `window`: the largest one of the search that some motion fits.
    """
    count = window.stop - window.start
    if count == len(t_s) or count < EXPLAINED_PART * len(t_s):
        return ""
    # rounded outwards, so that none of these samples is left out
    begin, end = np.floor(t_s[window.start]), np.ceil(t_s[window.stop - 1])
    do = f"estimate them by themselves (--from {begin:.0f} --to {end:.0f})"
    return f"motions fit the {count} samples from {begin:.0f} to {end:.0f} s: {do}"


def one_plane(panels: PanelPowers) -> str:
    """Return in words that panels whose normals lie in one plane do not distinguish mirror solutions; else an empty text."""
    if blind_axis(panels.response, np.any(panels.used, axis=0)) is None:
        return ""
    return (
        "the normals of all panels with readings lie in one plane, so each solution has a mirror solution with some signs reversed"
        ". A gyro, magnetometer or Sun sensor resolves this; inertia or wheels sometimes do"
    )


def accused_panels(names: tuple[str, ...], outliers: np.ndarray, lit: np.ndarray) -> list[str]:
    """Return a sentence on each panel with many outliers: at least `ACCUSED_LEAST`, and more than `ACCUSED_SHARE` of its readings.

    `names` (p) of the panels; `outliers` (n, p): probability of each reading to be an outlier, at samples in sunlight; `lit`
    (n, p): whether the reading is above the lit threshold.
    """
    # The expected number of outliers is compared with the number of readings that are lit or should be: where a dark reading is an
    # outlier, the panel should have been lit.
    expected = outliers.sum(axis=0)
    lit_or_outlier = (lit | (outliers > 0.5)).sum(axis=0)
    sentences = []
    for name, count, total in zip(names, expected, lit_or_outlier, strict=True):
        if count >= ACCUSED_LEAST and count > ACCUSED_SHARE * total:
            sentences.append(
                f"panel {name}: about {count:.0f} outliers (shadow, failed panel or wrong column)"
            )
    return sentences


def sigmas(solutions: xr.Dataset) -> np.ndarray:
    """Return the sigmas (r, 3) of the components of the rates of solutions, rad/s, from the group `solutions`."""
    return np.sqrt(np.einsum("kii->ki", solutions["omega_cov_B"].values))


def pass_row(
    findings: PosteriorFindings, tree: xr.DataTree, prior_sigma: float, columns_checked: str
) -> PassRow:
    """Return the solutions at the first sample and the answers to the four checks, as a row of the table of passes.

    `prior_sigma` (rad/s): of a component of the rate before the data. `columns_checked`: what the table says about the columns of
    the telemetry. The search counts as complete only if the draws are good too.
    """
    solutions, posterior, about = group(tree, "solutions"), group(tree, "posterior"), tree.attrs
    draws = posterior["omega_B"].values.reshape(-1, 3)
    solution_id = posterior["solution_id"].values.ravel()
    rate, covariance = solutions["omega_B"].values, solutions["omega_cov_B"].values
    # quantiles (r, 3) of the speed: of the draws themselves if there are enough, else of a normal distribution
    quantiles = np.quantile(drawn_speeds(rate, covariance), SPEEDS, axis=1).T
    speed = np.linalg.norm(draws, axis=1)
    enough = np.flatnonzero(solutions["effective_draws"].values >= TOO_FEW)
    for k in np.intersect1d(solution_id, enough):
        quantiles[k] = np.quantile(speed[solution_id == k], SPEEDS)
    likeliest = solution_id == 0
    if not likeliest.any():  # no draw of the result belongs to the likeliest solution
        likeliest[:] = True
    value = float(np.linalg.norm(rate[0]))
    sigma = float(np.sqrt(np.mean((speed[likeliest] - value) ** 2)))
    x, y, z = (bool(spread < NARROWER * prior_sigma) for spread in draws.std(axis=0))
    answers = Answers(
        unique=findings.unique,
        constrained=(x, y, z),
        fits=not findings.refused,
        search_complete=not (findings.doubts or findings.approximate),
        wrong=(),
        left_open="",
        speed=Speed(value, sigma, float(np.quantile(speed, UPPER))),
    )
    first = about["t_first_s"]
    return PassRow(
        samples=about["samples"],
        first_s=first,
        last_s=about["t_last_s"],
        at_s=first,
        probability=solutions["probability"].values,
        omega=rate,
        sigma=sigmas(solutions),
        speed=quantiles,
        answers=answers,
        columns_checked=columns_checked,
    )
