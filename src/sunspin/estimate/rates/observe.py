"""From telemetry to what the smoother of :mod:`sunspin.estimate.rates` reads: passes, and thinning."""

from __future__ import annotations

from collections import Counter

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.environment import Environment
from sunspin.estimate.orbit.field_calibration import FieldCalibration
from sunspin.estimate.rates.state import Observations
from sunspin.estimate.terms.field_direction import reads_directions
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.sensors import read_terms, sun_source
from sunspin.estimate.terms.sun_direction import UNREAD
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.quality import EMPTY, IDLE, LATE, STALE, find_late_frames
from sunspin.telemetry.repeats import GAP_FACTOR
from sunspin.vehicle import Vehicle

MAX_PASS_S = 3000.0
"""Longer passes are cut: half an orbit, over which a rate's wandering is still small against a turn."""

MAX_FIELD_S, MANY = 1000.0, 500
"""The same if a magnetometer is read. Without an orbit, that the field turns ever faster or slower holds for a sixth of one: over
half an orbit rates of simulated spinners were off by 0.03 deg/s at a stated sigma of 0.014. With one, if a long pass would have
more samples than the second number: kept samples 70 s apart, four turns at 21 deg/s left two of four undecided; of passes of
1900 s one was decided with a turn more between samples 5 s apart. Slow ones, read every 10 s, need the longer pass."""

MAX_DARK_S = 300.0
"""A pass goes on if the panels show no Sun for less than this and a magnetometer reads on; the shadow of the Earth lasts longer. A
body with one panel that turned once in 28 s had a pass for each turn."""

MAX_SAMPLES = 40
"""Samples of a pass beyond this are thinned."""

DENSE = 12
"""Samples among which a search looks for its first pairs."""

GROWTH = 1.4
"""Ratio of neighbouring steps of the thinned samples: they leave from the file's own interval and widen to even steps."""


FIELD_ALONE = "used: the field alone; "
"""What is said of a sample without a Sun whose field an orbit makes a direction."""

ALONE = "dropped: fewer than three samples between gaps (in no pass)"
NOT_ASKED = "dropped: in another pass than the one asked for"

NOT_SEEN = ("dropped: no panel lit", IDLE, EMPTY, UNREAD)
"""What is said of samples whose only fault is that they show no Sun."""


def observations(
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    source: str | None = None,
    environment: Environment | None = None,
    calibration: FieldCalibration | None = None,
) -> tuple[Observations, np.ndarray, str]:
    """All samples as `Observations`, a sentence for each (n), and where the Sun comes from.

    `source`: "sun_sensor", "panels" or "directions" (`sun_B` with `sun_cov_B`, as `sun_directions` returns them); default:
    the first of directions, Sun sensors, panels that the telemetry has. `environment`: with z of its N to the Sun;
    `calibration`: of the magnetometer along its orbit.
    """
    assessment = assess(vehicle, telemetry)
    telemetry = assessment.telemetry
    source = sun_source(
        telemetry, source, calibration is not None or reads_directions(vehicle, telemetry)
    )
    t = np.asarray(telemetry["time"], dtype=np.float64)
    terms, why = read_terms(assessment, source, calibration)
    if environment is not None:
        here = environment.at(t)
        terms = tuple(term.placed(here) for term in terms)
        known = [
            term.known.present()
            for term in terms
            if isinstance(term, Magnetometer) and term.known is not None
        ]
        field = np.logical_or.reduce([np.zeros(len(t), dtype=bool), *known])
        for k in np.flatnonzero(field & np.isin(why, NOT_SEEN)):
            why[k] = FIELD_ALONE + why[k].removeprefix("dropped: ")
    if source != "panels":
        why[assessment.repeats.frozen] = STALE
    why[find_late_frames(telemetry)] = LATE
    return Observations(t, np.zeros((len(t), 3)), terms), why, source


def usable(o: Observations, why: np.ndarray) -> np.ndarray:
    """Indices of the samples that are used: those that show the Sun, or a field whose direction is known."""
    alone = np.array([text.startswith(FIELD_ALONE) for text in why])
    return np.flatnonzero(
        (o.informed | alone) & np.array([not text.startswith("dropped") for text in why])
    )


def in_passes(
    use: np.ndarray, why: np.ndarray, every: list[np.ndarray], asked: list[int]
) -> np.ndarray:
    """Return the sentences (n) in which only the samples of the passes `asked` for are used.

    `use`: indices of usable samples; `every`: those of each pass of the file, of which some are in none.
    """
    why = why.copy()
    why[np.setdiff1d(use, np.concatenate(every))] = ALONE
    for k in set(range(len(every))) - set(asked):
        why[every[k]] = NOT_ASKED
    return why


def passes(o: Observations, why: np.ndarray, gap_s: float | None = None) -> list[np.ndarray]:
    """Indices of the samples of each pass, thinned; gaps longer than `gap_s` (default: six usual intervals) part them."""
    use = usable(o, why)
    if len(use) < 3:
        raise InputError(
            "fewer than three samples say where the Sun is",
            got=f"{len(use)} of {len(o)}",
            do=_why_unused(o, why),
        )
    times = o.t_s[use]
    gap = GAP_FACTOR * float(np.median(np.diff(times))) if gap_s is None else gap_s
    fields = [
        term
        for term in o.terms
        if isinstance(term, Magnetometer) and term.known is None and term.pairs().any()
    ]
    reads_field = any(isinstance(x, Magnetometer) and x.present().any() for x in o.terms)
    many = MAX_PASS_S / float(np.median(np.diff(times))) > MANY
    longest = MAX_FIELD_S if fields or (reads_field and many) else MAX_PASS_S
    ends = np.flatnonzero(np.diff(times) > gap)
    if fields and gap_s is None:
        read = o.t_s[fields[0].present()]
        ends = np.array(
            [k for k in ends if not _goes_on(read, times[k], times[k + 1], gap)], dtype=int
        )
    found = []
    for part in np.split(use, ends + 1):
        pieces = max(1, int(np.ceil((o.t_s[part[-1]] - o.t_s[part[0]]) / longest)))
        edges = o.t_s[part[0]] + np.arange(1, pieces) * (o.t_s[part[-1]] - o.t_s[part[0]]) / pieces
        pieces_of = np.split(part, np.searchsorted(o.t_s[part], edges))
        found += [
            thinned(piece, _dense_from(o.informed[piece])) for piece in pieces_of if len(piece) >= 3
        ]
    if not found:
        raise InputError(
            "no pass has three samples", got=f"gap between passes {gap:.4g} s", do="raise --gap"
        )
    return found


def _why_unused(o: Observations, why: np.ndarray) -> str:
    """Return why most samples are not used, and what to do."""
    dropped = np.array([text.startswith("dropped") for text in why])
    panels = [term for term in o.terms if isinstance(term, Panels)]
    shadow = ~dropped & np.logical_or.reduce(
        [np.zeros(len(o), dtype=bool), *(term.present() & (term.lit == 0) for term in panels)]
    )
    if shadow.sum() > dropped.sum():
        return (
            f"by the orbit {shadow.sum()} are in the Earth's shadow: compare clock and elements with `sunspin check`, "
            "or leave out the orbit"
        )
    if not dropped.any():
        return "add samples with a Sun direction"
    reason, count = Counter(text.removeprefix("dropped: ") for text in why[dropped]).most_common(1)[
        0
    ]
    return f"{count} dropped: {reason}; `sunspin check` says why samples are dropped"


def _goes_on(read_s: np.ndarray, start_s: float, end_s: float, gap_s: float) -> bool:
    """Whether readings at times (n) go on between two samples that show the Sun: a body with few panels turns them away."""
    between = read_s[(read_s >= start_s) & (read_s <= end_s)]
    return (
        end_s - start_s < MAX_DARK_S and len(between) > 1 and bool(np.diff(between).max() <= gap_s)
    )


def _dense_from(informed: np.ndarray) -> int:
    """From which of the samples of a pass a search may begin: the first if half of those next to it show the Sun (n, of true and
    false), else the one whose next ones show it most often. A pass that begins in the shadow shows it later."""
    after = np.convolve(informed, np.ones(DENSE))[DENSE - 1 :]
    return 0 if after[0] >= DENSE / 2 or len(informed) <= MAX_SAMPLES else int(np.argmax(after))


def thinned(index: np.ndarray, dense_from: int = 0) -> np.ndarray:
    """At most `MAX_SAMPLES` of the samples: close together where the rate is determined first, then ever farther apart, to the end
    and, from `dense_from` on, to the begin.

    Each step is at most `GROWTH` times the one before, so that what is known of the rate always carries to the next sample.
    """
    if len(index) <= MAX_SAMPLES:
        return index
    sides = index[dense_from:], index[dense_from::-1]
    splits = range(2, MAX_SAMPLES) if dense_from else ()
    shares = [
        (_thinned_to(sides[0], MAX_SAMPLES + 1 - n), _thinned_to(sides[1], n)) for n in splits
    ]
    shares = [pair for pair in shares if pair[0][-1] == index[-1] and pair[1][-1] == index[0]]
    if not shares:  # steps that grow to both sides do not reach the ends of a very long pass
        return _thinned_to(index, MAX_SAMPLES)
    return np.unique(
        np.concatenate(
            min(shares, key=lambda pair: max(np.abs(np.diff(side)).max(initial=0) for side in pair))
        )
    )


def _thinned_to(index: np.ndarray, most: int) -> np.ndarray:
    if len(index) <= most:
        return index
    low, high = 1.0, float(len(index))
    for _ in range(60):  # the largest step for which the steps reach the end
        widest = (low + high) / 2
        steps = np.minimum(GROWTH ** np.arange(most - 1), widest)
        low, high = (widest, high) if steps.sum() < len(index) - 1 else (low, widest)
    place = np.concatenate([[0.0], np.cumsum(np.minimum(GROWTH ** np.arange(most - 1), high))])
    return index[np.unique(np.minimum(np.round(place), len(index) - 1).astype(int))]
