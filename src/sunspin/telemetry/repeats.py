"""Samples that repeat earlier ones exactly: frozen telemetry, copies of a frame under another time, sensors that hold their values.

Equal readings alone prove nothing: counts are coarse, and a body at rest repeats itself. What counts is how likely two samples are
equal by chance. The file tells: from the differences between its own distinct samples, in steps of its own resolution.

Two samples `dt` apart differ by a vector of readings. Let distinct samples of the stretch, about `dt` apart, differ by `e` steps
in the column that differs most. The chance that all columns agree is then
about 1 / e^2: a Sun direction has two degrees of freedom.
Pairs farther apart than `dt` are scaled down in proportion, which is the least that a rotation changes. Slow or coarse stretches
have differences of one step, so their chance is near 1 and nothing is accused.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import pdtrc

from sunspin.telemetry.noise import bright_reading

SENSORS = ("sun_sensor_B", "gyro_B", "field_B", "attitude_B_from_N")
"""Variables of telemetry that are read by one sensor each, in addition to the panels."""

PANELS = "panels"
"""Name of the panels among the sensors that may hold their values."""

GAP_FACTOR = 6.0
"""A gap longer than this many usual intervals parts two stretches of samples, and two passes."""

COPY_SPAN_S = 60.0
"""Copies of a frame are looked for among samples up to this much earlier, or two usual intervals. Clocks and delays of ground
stations differ by seconds."""

LONGEST_LOOP = 10
"""Usual intervals between a frame and its copy if readings are noisy: a buffer may loop over its last frames."""

MOST_BETWEEN = 60
"""Samples, at most, between a frame and its copy."""

BY_CHANCE = 1e-3
"""Repeats are accused if chance makes as many in fewer than one file of a thousand."""

SAFETY = 3.0
"""Factor on the expected number of chance repeats, because few differences determine it."""

MOST_RIGHT = 0.1
"""Expected chance repeats may be this part of the repeats at most, so that nearly all that is left out is a repeat."""

LEAST_PAIRS = 5
"""Differences between distinct samples from which a chance is estimated; below, nothing can be said."""

LIT_SHARE = 0.15
"""A sample counts as lit above this part of the file's bright samples: equal rows in the shadow are no fault."""

HELD_SHARE = 0.3
"""A column that repeats its previous value in this part of its lit samples, beyond chance, refreshes at another cadence."""

LEAST_HELD = 6
"""Repeats of one column from which it may be said to hold its values."""

LONGEST_RUN = 4.0
"""Times the median run of equal values of such a column; a longer one has another reason."""

MOST_COUNTED = 4
"""Samples inside a run of equal ones that count for its chance."""

STEP = 1.25
"""Ratio of neighbouring intervals at which the chance is computed."""

SHARED = 0.5
"""Two rows with empty cells are compared if they share this part of the columns."""

NOISE_STEPS = 2.0
"""Changes of the darkest reading, in steps of its resolution, that are noise and no rounding."""

NOISY_SHARE = 0.2
"""Readings are noisy if so many of those changes are that large: with a sigma of two steps it is a third."""

FOLLOWS = 0.25
"""Samples come back in the same order if the neighbours of two equal ones differ by this part of a usual change at most."""

NONE = -1.7e300
"""Stands for a missing number when rows are compared."""


@dataclass(frozen=True, eq=False)
class Repeats:
    """Which samples (n) repeat earlier ones.

    `frozen` (n): all sensors repeat an earlier sample; `held`: by sensor (`PANELS` or a variable of telemetry) which samples (n)
    repeat its reading while another sensor reads something new; `columns` (n, n_panel): readings of panels that are refreshed less
    often than the others; `doubtful` (n): samples of stretches with too few distinct values to tell;
    `times_each`: how often each reading of those occurs.
    """

    frozen: np.ndarray
    held: dict[str, np.ndarray] = field(default_factory=dict)
    columns: np.ndarray | None = None
    doubtful: np.ndarray | None = None
    times_each: int = 1

    @property
    def unsure(self) -> np.ndarray:
        """Samples (n) that may repeat earlier ones, too few values being left to tell."""
        return np.zeros_like(self.frozen) if self.doubtful is None else self.doubtful

    @property
    def doubt(self) -> str:
        """What is said of these samples; empty if there are none."""
        if not self.unsure.any():
            return ""
        return f"each reading is repeated {self.times_each} times: held values?"

    def of(self, sensor: str) -> np.ndarray:
        """Return which samples (n) are no new reading of a sensor."""
        return self.frozen | self.held.get(sensor, np.zeros_like(self.frozen))


class Judged(NamedTuple):
    """Samples (n) that `repeated` an earlier one, and those of which that is `doubtful`."""

    repeated: np.ndarray
    doubtful: np.ndarray


def find_repeats(telemetry: xr.Dataset, value: np.ndarray | None, usable: np.ndarray) -> Repeats:
    """Return the samples of a file that repeat earlier ones.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`
    value : (n, n_panel), optional
        Readings of panels, NaN where none; None: the file has no panels.
    usable : (n)
        Samples that are in the order of time and have a reading.
    """
    time = np.asarray(telemetry["time"], dtype=np.float64)
    parts = {} if value is None else {PANELS: value}
    parts |= {
        name: np.asarray(telemetry[name], dtype=np.float64)
        for name in SENSORS
        if name in telemetry and np.isfinite(telemetry[name].values).any()
    }
    shows = {name: _shows(name, part) & usable for name, part in parts.items()}
    nothing = np.zeros(len(time), dtype=bool)
    if not parts:
        return Repeats(nothing)
    every = np.column_stack(list(parts.values()))
    usable = usable & np.isfinite(every).any(axis=1)
    whole = judge(time, every, np.logical_or.reduce(list(shows.values())), usable)
    rest, doubtful, held = usable & ~whole.repeated, whole.doubtful, {}
    for name, part in parts.items() if len(parts) > 1 else ():
        own = judge(time, part, rest & shows[name], rest)
        held[name] = own.repeated
        doubtful = doubtful | own.doubtful if name == PANELS else doubtful
    fresh = rest & ~held.get(PANELS, nothing)
    columns = None if value is None else _held_columns(time, value, fresh)
    distinct = len(np.unique(np.where(np.isfinite(every), every, NONE)[doubtful], axis=0))
    each = round(doubtful.sum() / max(distinct, 1))
    return Repeats(whole.repeated, held, columns, doubtful, each)


def judge(time: np.ndarray, value: np.ndarray, shows: np.ndarray, usable: np.ndarray) -> Judged:
    """Return which samples repeat an earlier one beyond chance, and of which that cannot be determined.

    Parameters
    ----------
    time : (n), s
    value : (n, n_column), NaN where nothing was read
    shows : (n)
        Samples that show something, such as a lit panel; repeats of others mean nothing.
    usable : (n)
        Samples that count as neighbours.
    """
    repeated, doubtful = np.zeros((2, len(time)), dtype=bool)
    index = np.flatnonzero(shows)
    if len(index) < 2:
        return Judged(repeated, doubtful)
    t, rows = time[index], _completed(value[index])
    known = np.isfinite(rows)
    _, same = np.unique(np.where(known, rows, NONE), axis=0, return_inverse=True)
    same = same.ravel()
    adjacent = np.concatenate([[False], np.diff(np.cumsum(usable)[index]) == 1])
    again = adjacent & np.concatenate([[False], same[1:] == same[:-1]])
    if len(np.unique(same)) == len(same):
        return Judged(repeated, doubtful)
    usual = float(np.median(np.diff(t[~again]))) if (~again).sum() > 1 else np.inf
    stretch = np.cumsum(np.concatenate([[0], np.diff(t) > GAP_FACTOR * usual]))
    rows = rows / resolution(rows)
    # noise does not come back: readings that show it recur by no rotation
    noisy = _noisy(rows[np.unique(same, return_index=True)[1]])
    span_s = max(COPY_SPAN_S, (LONGEST_LOOP if noisy else 2) * usual)
    recurring = 0.0 if noisy else _recurrence(t[~again], same[~again], span_s)
    # copies first: left in, they would look like differences of nothing
    pairs = _pairs_before(t, same, again, span_s)
    if not noisy:
        pairs.equal[_in_order(rows, again, pairs)] = False
    copied = np.zeros(len(t), dtype=bool)
    late = np.unique(pairs.later[pairs.equal])
    fresh = ~again & ~np.isin(np.arange(len(t)), late)
    for which, chance in _chances(t, rows, stretch, fresh, recurring):
        own = which[pairs.later]
        expected = chance.at(t[pairs.later[own]] - t[pairs.earlier[own]]).sum()
        copied[late[which[late]]] = _more_than(expected, int(which[late].sum()))
    repeats, judged = copied.copy(), np.zeros(len(t), dtype=bool)
    for which, chance in _chances(t, rows, stretch, ~again & ~copied, recurring):
        repeats |= _runs_beyond_chance(t, again & which, adjacent & which, chance)
        judged |= which
    for number in np.unique(stretch[again & ~judged]):
        own = stretch == number
        if own.sum() >= 2 * (own & ~again).sum():
            doubtful[index[own]] = True
    repeated[index] = repeats
    return Judged(repeated, doubtful)


def _completed(rows: np.ndarray) -> np.ndarray:
    """Return rows (n, n_column) with empty cells filled from the row before or after, if it is equal in the columns that both fill
    and these show something."""
    rows = rows[:, np.isfinite(rows).any(axis=0)].copy()
    for back in (1, -1):
        order = rows[::back]  # a view: from the row before, then from the row after
        known = np.isfinite(order)
        both = known[1:] & known[:-1]
        agree = (both & (order[1:] != order[:-1])).sum(axis=1) == 0
        shown = (both & (order[1:] != 0)).any(axis=1)
        enough = both.sum(axis=1) >= SHARED * rows.shape[1]
        for k in (np.flatnonzero(agree & shown & enough & ~known[1:].all(axis=1)) + 1).tolist():
            filled = np.where(known[k], order[k], order[k - 1])
            both_now = known[k] & np.isfinite(order[k - 1])
            if np.array_equal(order[k][both_now], order[k - 1][both_now]):
                order[k] = filled
    return rows


def _noisy(rows: np.ndarray) -> bool:
    """Return whether distinct rows (n, n_column), in steps and in any order, show noise beyond their resolution: in the dark a
    reading without noise stays the same."""
    darkest = np.where(np.isfinite(rows), rows, np.inf).min(axis=1, initial=np.inf)
    changes = np.abs(np.diff(darkest[np.isfinite(darkest)]))
    return len(changes) >= LEAST_PAIRS and bool(np.mean(changes >= NOISE_STEPS) > NOISY_SHARE)


def _in_order(rows: np.ndarray, again: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Return the places of equal pairs whose neighbours agree as well, as in a rotation whose period is near a number of samples. A
    copy stands between other frames than its original."""
    place, equal = np.flatnonzero(~again), np.flatnonzero(pairs.equal)
    order = np.nan_to_num(rows[place])
    a, b = (np.searchsorted(place, each[equal]) for each in (pairs.earlier, pairs.later))
    agree = np.ones(len(equal), dtype=bool)
    for step in (-1, 1):
        there = (a + step >= 0) & (b + step < len(place))
        c, d = np.maximum(a + step, 0), np.minimum(b + step, len(place) - 1)
        apart = np.abs(order[c] - order[d]).max(axis=1, initial=0.0)
        change = np.abs(order[d] - order[b]).max(axis=1, initial=0.0)
        agree &= ~there | (apart <= np.maximum(NOISE_STEPS, FOLLOWS * change))
    return equal[agree]


def resolution(value: np.ndarray) -> np.ndarray:
    """Return the step of each column (n_column): the least difference between two of its values; infinite if it has one value."""
    steps = np.full(value.shape[1], np.inf)
    for k, column in enumerate(value.T):
        levels = np.unique(column[np.isfinite(column)])
        gaps = np.diff(levels)
        gaps = gaps[gaps > 1e-9 * np.abs(levels).max(initial=0.0)]  # smaller ones are rounding
        steps[k] = gaps.min(initial=np.inf)
    return steps


@dataclass(frozen=True, eq=False)
class Chance:
    """The chance that two distinct samples are equal, by their interval.

    `parts`: times (m) and readings (m, n_column), in steps of their resolution, of distinct samples of each stretch; `least`: the
    chance at any interval.
    """

    parts: tuple[tuple[np.ndarray, np.ndarray], ...]
    least: float
    degrees: float = 2.0

    def at(self, interval: np.ndarray) -> np.ndarray:
        """Return it for each interval (m), s; those within `STEP` of each other share one, that of the shortest."""
        place = np.floor(np.log(np.maximum(interval, 1e-9)) / np.log(STEP))
        values, of = np.unique(place, return_inverse=True)
        each = np.array([self._mean(STEP**value) for value in values.tolist()])
        return np.maximum(each, self.least)[of.ravel()] if len(each) else np.zeros(0)

    def _mean(self, interval: float) -> float:
        """Return the mean of 1 / e^2 over pairs of distinct samples about this far apart (s), e in steps."""
        shares = [np.zeros(0)]
        for t, rows in self.parts:
            lag, most = 1, len(t) // 2
            while lag < most and np.median(t[lag:] - t[:-lag]) < interval:
                lag = min(most, lag + max(1, lag // 4))
            apart = t[lag:] - t[:-lag]
            differ = np.abs(rows[lag:] - rows[:-lag])
            known = np.isfinite(differ).any(axis=1) & (apart > 0)
            largest = np.max(np.nan_to_num(differ[known]), axis=1, initial=0.0)
            scaled = largest * np.minimum(1.0, interval / apart[known])
            shares.append(np.maximum(scaled, 1.0) ** -self.degrees)
        every = np.concatenate(shares)
        return float(every.mean()) if len(every) else 1.0


def _chances(
    t: np.ndarray, rows: np.ndarray, stretch: np.ndarray, fresh: np.ndarray, least: float
) -> Iterator[tuple[np.ndarray, Chance]]:
    """Yield the samples (n) that are judged together, and their chance: each stretch by its own distinct samples `fresh` (n); those
    with too few by all of the file. A stretch of a single value may be a body at rest and is not judged."""
    count = np.bincount(stretch, weights=fresh)
    parts = {
        k: (t[own], rows[own])
        for k in np.flatnonzero(count > 1).tolist()
        if (own := (stretch == k) & fresh).any()
    }
    rich = [k for k in parts if count[k] > LEAST_PAIRS]
    poor = [k for k in parts if count[k] <= LEAST_PAIRS]
    for k in rich:
        yield stretch == k, Chance((parts[k],), least)
    if poor and sum(len(times) - 1 for times, _ in parts.values()) >= LEAST_PAIRS:
        yield np.isin(stretch, poor), Chance(tuple(parts.values()), least)


def _recurrence(t: np.ndarray, same: np.ndarray, span_s: float) -> float:
    """Return the share of pairs of samples that are equal although their value comes back over more than twice the span of copies:
    coarse or periodic readings do."""
    order = np.lexsort((t, same))
    _, first, count = np.unique(same[order], return_index=True, return_counts=True)
    lasts = t[order][first + count - 1] - t[order][first]
    equal = (count * (count - 1) / 2)[lasts > 2 * span_s].sum()
    return float(equal / max(len(t) * (len(t) - 1) / 2, 1.0))


class Pairs(NamedTuple):
    """Pairs (m) of samples that are no neighbours but near: their places, and whether their readings are equal."""

    earlier: np.ndarray
    later: np.ndarray
    equal: np.ndarray


def _pairs_before(t: np.ndarray, same: np.ndarray, again: np.ndarray, span_s: float) -> Pairs:
    """Return the pairs of samples that may be a frame and its copy, other samples having come between; none repeats the sample just
    before it."""
    place = np.flatnonzero(~again)
    earlier, later = [], []
    for lag in range(2, min(MOST_BETWEEN, len(place) - 1) + 1):
        near = t[place[lag:]] - t[place[:-lag]] <= span_s
        if not near.any():
            break
        earlier.append(place[:-lag][near])
        later.append(place[lag:][near])
    none = np.zeros(0, dtype=int)
    first, second = (np.concatenate([none, *each]) for each in (earlier, later))
    return Pairs(first, second, same[first] == same[second])


def _more_than(expected: float, count: int) -> bool:
    """Return whether so many repeats are more than chance makes: once in a thousand files, and a tenth of them at most."""
    return (
        count > 0
        and expected <= MOST_RIGHT * count
        and bool(pdtrc(count - 1, SAFETY * expected) < BY_CHANCE)
    )


def _runs_beyond_chance(
    t: np.ndarray, again: np.ndarray, adjacent: np.ndarray, chance: Chance
) -> np.ndarray:
    """Return which samples (n) that equal the one before are no chance: all if they are too many, else those of long runs.

    A run of m equal samples over a time has the chance of equal samples so far apart, and for each sample between the root of that
    of neighbours: the root, because a slow phase of a rotation lasts.
    """
    by_run = np.zeros(len(t), dtype=bool)
    if not again.any():
        return by_run
    neighbours = np.flatnonzero(adjacent)
    by_neighbours = chance.at(t[neighbours] - t[neighbours - 1])
    begins = np.flatnonzero(again & ~np.concatenate([[False], again[:-1]])) - 1
    if _more_than(by_neighbours.sum(), len(begins)):
        return again
    ends = np.flatnonzero(again & ~np.concatenate([again[1:], [False]]))
    between = np.minimum(ends - begins - 1, MOST_COUNTED)
    each = chance.at(t[ends] - t[begins]) * by_neighbours.mean() ** (between / 2)
    for begin, end, by_chance in zip(begins, ends, each, strict=True):
        if SAFETY * len(neighbours) * by_chance < BY_CHANCE:
            by_run[begin + 1 : end + 1] = True
    return by_run


def _held_columns(time: np.ndarray, value: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Return the readings (n, n_panel) that a panel's column repeats although others change, if it does so throughout."""
    held = np.zeros(value.shape, dtype=bool)
    lit = value > LIT_SHARE * bright_reading(value)
    for k in range(value.shape[1]):
        at = np.flatnonzero(fresh & lit[:, k])
        if len(at) < 2 * LEAST_HELD:
            continue
        t, column = time[at], value[at, k]
        next_to = np.concatenate([[False], np.diff(np.cumsum(fresh)[at]) == 1])
        again = next_to & np.concatenate([[False], column[1:] == column[:-1]])
        # a sensor that holds its values repeats each about as often; a panel on the spin axis has one long run
        runs = np.diff(np.append(np.flatnonzero(~again), len(again)))
        if not 2 <= np.median(runs) or runs.max() > LONGEST_RUN * np.median(runs):
            continue
        step = resolution(column[:, None])
        # differences within one lit stretch; from one to the next they say little
        lit_stretch = np.cumsum(~next_to)
        changed = tuple(
            (t[own], column[own, None] / step)
            for number in np.unique(lit_stretch)
            if (own := (lit_stretch == number) & ~again).sum() > 1
        )
        few = sum(len(times) - 1 for times, _ in changed) < LEAST_PAIRS
        if few or again.sum() < max(LEAST_HELD, HELD_SHARE * next_to.sum()):
            continue
        # one column has one degree of freedom, and a rotation brings its values back
        chance = Chance(changed, 0.0, 1.0)
        places = np.flatnonzero(next_to)
        if _more_than(chance.at(t[places] - t[places - 1]).sum(), int(again.sum())):
            held[at[again], k] = True
    return held


def _shows(name: str, part: np.ndarray) -> np.ndarray:
    """Return the samples (n) at which a sensor shows something: panels the Sun, others any numbers but zeros."""
    if name != PANELS:
        return np.isfinite(part).all(axis=1) & (part != 0).any(axis=1)
    largest = np.where(np.isfinite(part), part, 0.0).max(axis=1, initial=0.0)
    return largest > LIT_SHARE * bright_reading(part)
