"""What the posterior says, in words; above all when it does not know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sunspin.estimate.passes import SPEEDS, PassMotions, speed_of, speeds
from sunspin.estimate.verdict import answers

NOT_EXPLAINED = 0.002
"""Chance of readings this bad below which no motion found explains them; and the noise's distance that does the same."""

NOISE_LIMIT = 3.5

TAIL_LIMIT, EFFECTIVE_LIMIT = 0.55, 700.0
"""Pareto's k above which, and number of effective draws below which, the sample is not to be trusted."""

COUNTS = 0.01
"""A region with less weight is not counted."""

LEAST_WEIGHT = 1e-4
"""Regions with less weight are not listed, and modes with half as much of the likeliest's (Laplace's method) get no component. Of
300 modes of Philae 44 s apart 13 have more; all of them, under the sizes of a torque, had 11,000 components."""

TOO_FEW = 10.0
"""Effective draws below which a region's sigma is that of the draws proposed there, as that of one draw would be zero; and below
which it is not listed where it does not count."""

UNIQUE = 0.99

LINE_TURN, LINE_REGIONS = 0.15, 25
"""A region longer than this in rad/s, or as many regions as this, are a line rather than points."""

PANEL_SHARE = 0.4
"""A panel with this part of its readings spoilt, and at least three of them, is named."""

DARK_RUN = 3
"""So many samples in a row without any lit panel may be a shadow, which no motion explains."""


@dataclass(frozen=True)
class Found:
    """What the verdict is made of: regions' weights, rates (r, 3), longest sigma of each (rad/s), starts that led to each, interval
    of the samples (s), check, tail, effective draws, remarks that put the search in doubt; `speed` (r), rad/s, root mean square:
    a region's draws turn faster than its mean rate; `dark`: the stretch in which nothing was lit, in words; `complete`: all
    motions that may fit were followed."""

    weight: np.ndarray
    rate: np.ndarray
    length: np.ndarray
    hits: np.ndarray
    interval_s: float
    p: float
    noise_sigmas: float
    spoilt: list[str]
    tail: float
    effective: float
    doubts: list[str]
    speed: np.ndarray
    dark: str = ""
    complete: bool = True

    @property
    def rough(self) -> bool:
        """Whether the sample is not to be trusted."""
        return self.tail > TAIL_LIMIT or self.effective < EFFECTIVE_LIMIT

    @property
    def is_unique(self) -> bool:
        """Whether one region of motions is left, and is no line."""
        told = np.flatnonzero(self.weight >= COUNTS)
        return bool(len(told) == 1 and self.weight[0] >= UNIQUE and not _is_line(self, told))


def verdict(found: Found) -> tuple[str, str]:
    """A word ("unique", "aliases", "line", "not explained", "not sure") and the sentence."""
    told = np.flatnonzero(found.weight >= COUNTS)
    if refused(found.p, found.noise_sigmas):
        if not found.complete:
            return (
                "not sure",
                f"not sure: {'; '.join(found.doubts)}; none of the solutions searched fits",
            )
        return "not explained", _not_explained(found)
    doubts = list(found.doubts)
    if found.rough:
        size = f"effective sample size only {found.effective:.0f} (Pareto k {found.tail:.2f})"
        doubts.append(f"{size}: errors and probabilities are approximate")
    text, word = _regions(found, told), word_of(found)
    if found.spoilt:
        text += "; " + "; ".join(found.spoilt)
    if doubts:
        return "not sure", f"not sure: {'; '.join(doubts)}; result so far: {text}"
    return word, text


def word_of(found: Found) -> str:
    """What the regions alone say, readings and search set aside: "line", "unique" or "aliases"."""
    told = np.flatnonzero(found.weight >= COUNTS)
    return "line" if _is_line(found, told) else "unique" if found.is_unique else "aliases"


def refused(p: float, noise_sigmas: float) -> bool:
    """Whether readings this bad, or noise this far from what was stated, mean that no motion explains them."""
    return p < NOT_EXPLAINED or abs(noise_sigmas) > NOISE_LIMIT


def _is_line(found: Found, told: np.ndarray) -> bool:
    return bool(len(told) >= LINE_REGIONS or found.length[told].max(initial=0.0) > LINE_TURN)


def _regions(found: Found, told: np.ndarray) -> str:
    if _is_line(found, told):
        reach = 2 * max(
            float(found.length[told].max()), float(np.ptp(found.rate[told], axis=0).max()) / 2
        )
        return f"a line of solutions over {np.degrees(reach):.2g} deg/s fits equally well; the data do not select one"
    best = f"{np.degrees(found.speed[0]):.3g} deg/s"
    if len(told) == 1 and found.weight[0] >= UNIQUE:
        return f"unique: a single solution, with an angular speed of {best}, fits the readings"
    if len(told) == 1:
        others = int((found.weight > 0).sum()) - 1
        share = f"{found.weight[0]:.1%} of the probability, {others} others have the rest"
        return f"several solutions: the likeliest, at {best}, has {share}"
    gaps = np.linalg.norm(found.rate[told][:, None] - found.rate[told][None], axis=-1)
    gap = float(np.median(np.min(gaps + np.diag(np.full(len(told), np.inf)), axis=1)))
    text = f"{len(told)} aliases, {np.degrees(gap):.3g} deg/s apart, fit equally well"
    text += f"; the likeliest, at {best}, has {found.weight[0]:.0%} of the probability"
    extra = "one extra revolution between samples"
    return f"{text} ({extra} would be {360 / found.interval_s:.3g} deg/s)"


def _not_explained(found: Found) -> str:
    text = f"not explained: no solution fits; residuals as large as these have a probability of {found.p:.2g}"
    if abs(found.noise_sigmas) > NOISE_LIMIT:
        side = "more" if found.noise_sigmas > 0 else "less"
        text = "not explained: no solution fits unless the noise is far "
        text += f"{side} than assumed ({found.noise_sigmas:+.1f} sigma)"
    text = "; ".join([text, *found.spoilt, *found.doubts])
    if found.dark:
        return f"{text}; {found.dark}. If this is an eclipse, exclude it with --from and --to (begin_s, end_s)"
    return f"{text}. Check the vehicle file, the time window, the wheels, and for shaded or failed panels"


def dark_stretch(t_s: np.ndarray, lit: np.ndarray) -> str:
    """When no panel was lit for `DARK_RUN` samples or more, the longest such time; empty where there is none.

    `t_s` (K) from the epoch; `lit` (K), whether any panel was lit.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[True], lit, [True]]).astype(int)))
    begin, end = edges[::2], edges[1::2]
    if not len(begin) or (count := int((end - begin).max())) < DARK_RUN:
        return ""
    k = int(np.argmax(end - begin))
    return f"no panel lit from {t_s[begin[k]]:.6g} to {t_s[end[k] - 1]:.6g} s ({count} samples)"


def spoilt_panels(names: tuple[str, ...], outliers: np.ndarray, lit: np.ndarray) -> list[str]:
    """Sentences on panels of which much is no sunlight; `outliers` (K, P) as in the check, `lit` (K, P)."""
    told = []
    count, base = outliers.sum(axis=0), np.maximum(np.maximum(lit, outliers > 0.5).sum(axis=0), 1)
    for name, n, of in zip(names, count, base, strict=True):
        if n >= 3 and n > PANEL_SHARE * of:
            told.append(
                f"panel {name}: about {n:.0f} outliers (shadow, failed panel or wrong column)"
            )
    return told


def believed(
    found: Found, tree: Any, prior_sigma: float, tags_off: bool, columns_checked: str
) -> PassMotions:
    """The posterior's motions at the first sample, and the three answers. `tree`: its draws and regions; `prior_sigma`: that of a
    component of the rate in the ball that was searched; `tags_off`: the readings ask for errors of time tags said to be exact."""
    modes, about = tree["solutions"], tree.attrs
    drawn = tree["posterior"]["omega_B"].values.reshape(-1, 3)
    region = tree["posterior"]["solution_id"].values.ravel()
    covariance = modes["omega_cov_B"].values
    speed = speeds(modes["omega_B"].values, covariance)
    enough = np.flatnonzero(modes["effective_draws"].values >= TOO_FEW)
    for k in np.intersect1d(region, enough):  # the draws themselves, where there are enough
        speed[k] = np.quantile(np.linalg.norm(drawn[region == k], axis=1), SPEEDS)
    explained = not (tags_off or refused(found.p, found.noise_sigmas))
    complete = (
        len(found.doubts) == int(tags_off) and not found.rough
    )  # of the doubts that one is about the fit
    first = about["t_first_s"]
    judged = answers(found.is_unique, drawn.std(axis=0), prior_sigma, explained, complete)
    drawn_speed = np.linalg.norm(drawn, axis=1)
    best = region == region.min(initial=0)
    if not best.any():  # no draw fell to it
        best[:] = True
    parts = [drawn_speed[best], drawn_speed[~best]]
    parts = [part for part in parts if len(part)]
    judged = judged._replace(
        speed=speed_of(modes["omega_B"].values[0], parts, np.array([len(part) for part in parts]))
    )
    return PassMotions(
        about["samples"],
        first,
        about["t_last_s"],
        first,
        modes["probability"].values,
        modes["omega_B"].values,
        sigmas(modes),
        speed,
        judged,
        columns_checked,
    )


def sigmas(modes: Any) -> np.ndarray:
    """Sigmas (solution, 3) of the regions' rates in rad/s."""
    return np.asarray(np.sqrt(np.einsum("kii->ki", modes["omega_cov_B"].values)))


def summary(tree: Any) -> dict[str, Any]:
    """The main numbers of a posterior as plain data."""
    posterior, modes = tree["posterior"], tree["solutions"]
    rate = np.linalg.norm(posterior["omega_B"].values.reshape(-1, 3), axis=1)
    low, median, high = (float(np.quantile(rate, q)) for q in (0.05, 0.5, 0.95))
    return {
        "verdict": tree.attrs["verdict"],
        "verdict_word": tree.attrs["verdict_word"],
        "rate_rad_s": {"median": median, "low_90": low, "high_90": high},
        "solutions": [
            {
                "probability": float(w),
                "omega_B": o.tolist(),
                "sigma": s.tolist(),
                "chi_square": float(x),
                "starts": int(h),
                "effective_draws": float(n),
            }
            for w, o, s, x, h, n in zip(
                modes["probability"].values,
                modes["omega_B"].values,
                sigmas(modes),
                modes["chi_square"].values,
                modes["starts"].values,
                modes["effective_draws"].values,
                strict=True,
            )
        ],
        "p_value": float(tree.attrs["p_value"]),
        "effective_draws": float(tree.attrs["effective_draws"]),
        "pareto_k": float(tree.attrs["pareto_k"]),
        "synthetic_telemetry": bool(tree.attrs.get("synthetic", 0)),
    }
