"""Samples that repeat earlier ones exactly: frozen telemetry, copies of a frame under another time, sensors that hold their values.

Equal readings alone prove nothing: counts are coarse, and a body at rest repeats itself. A repeat is accepted only if two samples
are unlikely to be equal by chance. This probability is estimated from the differences between distinct samples of the file, in
steps of the resolution of its columns.

Consider two samples an interval `dt` apart. Let distinct samples of the same stretch, about `dt` apart, differ by `e` steps in the
column that differs most. The probability that all columns agree is then about 1 / e^2, because a Sun direction has two degrees of
freedom. Differences over an interval longer than `dt` are scaled down in proportion. Slow or coarse stretches have differences of
one step, so that the probability is near 1 and no repeat is accepted.
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
"""Variables of telemetry that come from one sensor each, in addition to the panels."""

PANELS = "panels"
"""Name of the panels among the sensors that may hold their values."""

GAP_FACTOR = 6.0
"""A gap longer than this many median intervals separates two stretches of samples, and two passes."""

COPY_SPAN_S = 60.0
"""Largest interval between a frame and its copy, or two median intervals if these are longer. Clocks and delays of ground stations
differ by seconds."""

STATION_DELAY_S = 10.0
"""Largest interval between the same frame from two ground stations, for equal rows that follow each other."""

APART = 0.25
"""Such rows follow each other within this share of the intervals before and after them."""

LONGEST_LOOP = 10
"""Largest interval, in median intervals, between a frame and its copy if readings are noisy: a buffer may repeat its frames."""

MOST_BETWEEN = 60
"""Largest number of samples between a frame and its copy."""

BY_CHANCE = 1e-3
"""Largest probability that chance makes as many repeats in a file, for repeats to be accepted."""

SAFETY = 3.0
"""Factor on the expected number of chance repeats, because it is estimated from few differences."""

MOST_RIGHT = 0.1
"""Largest ratio of expected chance repeats to all repeats, so that nearly all samples left out are repeats."""

LEAST_PAIRS = 5
"""Smallest number of differences between distinct samples from which a probability is estimated."""

LIT_SHARE = 0.15
"""A sample counts as lit above this share of a bright reading: equal rows in the shadow are no fault."""

HELD_SHARE = 0.3
"""A column that repeats its previous value in this share of its lit samples, beyond chance, is refreshed less often than others."""

LEAST_HELD = 6
"""Smallest number of repeats of one column from which it may hold its values."""

LONGEST_RUN = 4.0
"""Largest ratio of the longest to the median run of equal values of such a column; longer runs have another cause."""

MOST_COUNTED = 4
"""Largest number of samples inside a run of equal ones that count for its probability."""

STEP = 1.25
"""Ratio of successive intervals at which the probability is computed."""

SHARED = 0.5
"""Two rows with empty cells are compared if both fill this share of the columns."""

NOISE_STEPS = 2.0
"""A change of the darkest reading by so many steps of its resolution is noise and not rounding."""

NOISY_SHARE = 0.2
"""Readings are noisy if this share of those changes is that large: with a sigma of two steps it is a third."""

FOLLOWS = 0.25
"""Two equal samples belong to a periodic sequence if their neighbours differ by at most this share of a usual change."""

NONE = -1.7e300
"""Stands for a missing number when rows are compared."""


@dataclass(frozen=True, eq=False)
class Repeats:
    """Samples (n) that repeat earlier ones.

    `frozen` (n): all sensors repeat an earlier sample; `held`: sensor (`PANELS` or a variable of telemetry) -> samples (n) that
    repeat its reading while another sensor has a new one; `columns` (n, n_panel): readings of panels that are refreshed less often
    than the others; `doubtful` (n): samples of stretches with too few distinct values to decide; `times_each`: how often each
    reading of those occurs.
    """

    frozen: np.ndarray
    held: dict[str, np.ndarray] = field(default_factory=dict)
    columns: np.ndarray | None = None
    doubtful: np.ndarray | None = None
    times_each: int = 1

    @property
    def unsure(self) -> np.ndarray:
        """Samples (n) that may repeat earlier ones, of stretches with too few distinct values to decide."""
        return np.zeros_like(self.frozen) if self.doubtful is None else self.doubtful

    @property
    def doubt(self) -> str:
        """Message on these samples; empty if there are none."""
        if not self.unsure.any():
            return ""
        return f"each reading is repeated {self.times_each} times: held values?"

    def repeated(self, sensor: str) -> np.ndarray:
        """Return the samples (n) that are no new reading of a sensor (`PANELS` or a variable of telemetry)."""
        return self.frozen | self.held.get(sensor, np.zeros_like(self.frozen))


class RepeatedRows(NamedTuple):
    """Rows (n) that repeat an earlier one, and rows (n) of which this cannot be decided (`doubtful`)."""

    repeated: np.ndarray
    doubtful: np.ndarray


def find_repeats(telemetry: xr.Dataset, value: np.ndarray | None, usable: np.ndarray) -> Repeats:
    """Return the samples of a file that repeat earlier ones.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`
    value : (n, n_panel), optional
        Panel readings, NaN if missing; None if the file has no panels.
    usable : (n)
        Samples that are in the order of time and have a reading.
    """
    time = np.asarray(telemetry["time"], dtype=np.float64)
    readings = {} if value is None else {PANELS: value}  # sensor -> (n, n_column)
    readings |= {
        name: np.asarray(telemetry[name], dtype=np.float64)
        for name in SENSORS
        if name in telemetry and np.isfinite(telemetry[name].values).any()
    }
    signal = {name: _has_signal(name, columns) & usable for name, columns in readings.items()}
    no_samples = np.zeros(len(time), dtype=bool)
    if not readings:
        return Repeats(no_samples)
    # first the samples that repeat in all sensors, then among the rest those that repeat in one sensor
    all_columns = np.column_stack(list(readings.values()))
    usable = usable & np.isfinite(all_columns).any(axis=1)
    any_signal = np.logical_or.reduce(list(signal.values()))
    copied = _from_two_stations(time, all_columns, usable)
    usable = usable & ~copied
    frozen = find_repeated_rows(time, all_columns, any_signal & usable, usable)
    rest, doubtful = usable & ~frozen.repeated, frozen.doubtful
    held: dict[str, np.ndarray] = {}
    if len(readings) > 1:  # with one sensor, held values are frozen samples
        for name, columns in readings.items():
            of_sensor = find_repeated_rows(time, columns, rest & signal[name], rest)
            held[name] = of_sensor.repeated
            if name == PANELS:  # doubts are reported for all sensors together and for the panels
                doubtful = doubtful | of_sensor.doubtful
    new_panels = rest & ~held.get(PANELS, no_samples)
    held_columns = None if value is None else _find_held_columns(time, value, new_panels)
    doubtful_rows = np.where(np.isfinite(all_columns), all_columns, NONE)[doubtful]
    n_distinct = len(np.unique(doubtful_rows, axis=0))
    times_each = round(doubtful.sum() / max(n_distinct, 1))
    return Repeats(copied | frozen.repeated, held, held_columns, doubtful, times_each)


def find_repeated_rows(
    time: np.ndarray, value: np.ndarray, signal: np.ndarray, usable: np.ndarray
) -> RepeatedRows:
    """Return the rows that repeat an earlier one beyond chance, and the rows of which this cannot be decided.

    Parameters
    ----------
    time : (n), s
    value : (n, n_column), NaN if nothing was read
    signal : (n)
        Rows with a signal, such as a lit panel; repeats of others mean nothing.
    usable : (n)
        Rows that count as neighbours.
    """
    repeated, doubtful = np.zeros((2, len(time)), dtype=bool)
    index = np.flatnonzero(signal)
    if len(index) < 2:
        return RepeatedRows(repeated, doubtful)
    # From here on, only rows with a signal. `same`: number of the distinct row to which each is equal; `equals_previous`: equal to
    # its immediate neighbour in the file.
    t, rows = time[index], _fill_empty_cells(value[index])
    known = np.isfinite(rows)
    _, same = np.unique(np.where(known, rows, NONE), axis=0, return_inverse=True)
    same = same.ravel()
    adjacent = np.concatenate([[False], np.diff(np.cumsum(usable)[index]) == 1])
    equals_previous = adjacent & np.concatenate([[False], same[1:] == same[:-1]])
    if len(np.unique(same)) == len(same):
        return RepeatedRows(repeated, doubtful)
    changes = t[~equals_previous]
    median_interval = float(np.median(np.diff(changes))) if len(changes) > 1 else np.inf
    stretch = np.cumsum(np.concatenate([[0], np.diff(t) > GAP_FACTOR * median_interval]))
    rows = rows / resolution(rows)
    # a periodic rotation brings readings back, but not their noise
    distinct_rows = rows[np.unique(same, return_index=True)[1]]
    noisy = _is_noisy(distinct_rows)
    span_s = max(COPY_SPAN_S, (LONGEST_LOOP if noisy else 2) * median_interval)
    recurring = 0.0 if noisy else _recurrence(t[~equals_previous], same[~equals_previous], span_s)
    # 1. Copies, which have other rows in between. They come first, because the differences between distinct rows must not contain
    # them.
    pairs = _find_near_pairs(t, same, equals_previous, span_s)
    if not noisy:
        pairs.equal[_find_periodic_pairs(rows, equals_previous, pairs)] = False
    copied = np.zeros(len(t), dtype=bool)
    possible_copies = np.unique(pairs.later[pairs.equal])
    fresh = ~equals_previous & ~np.isin(np.arange(len(t)), possible_copies)
    counts = []
    # `group` (n): rows that are judged together
    for group, chance in _chances(t, rows, stretch, fresh, recurring):
        in_group = group[pairs.later]
        earlier, later = pairs.earlier[in_group], pairs.later[in_group]
        expected = chance.at(t[later] - t[earlier]).sum()
        copies = possible_copies[group[possible_copies]]
        copied[copies] = _exceeds_chance(expected, len(copies))
        counts.append(RepeatCount(expected, len(later), len(copies), copies))
    copied[_beyond_chance_together(counts)] = True
    # 2. Runs of equal neighbours
    repeats, judged, counts = copied.copy(), np.zeros(len(t), dtype=bool), []
    for group, chance in _chances(t, rows, stretch, ~equals_previous & ~copied, recurring):
        repeats |= _runs_beyond_chance(t, equals_previous & group, adjacent & group, chance)
        judged |= group
        neighbours = np.flatnonzero(adjacent & group)
        expected = chance.at(t[neighbours] - t[neighbours - 1]).sum()
        equal = equals_previous & group
        n_runs = int((equal[1:] & ~equal[:-1]).sum())  # the first row equals none
        counts.append(RepeatCount(expected, len(neighbours), n_runs, np.flatnonzero(equal)))
    repeats[_beyond_chance_together(counts)] = True
    # 3. Stretches without enough distinct rows for a probability, in which each row occurs at least twice on average
    for number in np.unique(stretch[equals_previous & ~judged]):
        in_stretch = stretch == number
        if in_stretch.sum() >= 2 * (in_stretch & ~equals_previous).sum():
            doubtful[index[in_stretch]] = True
    repeated[index] = repeats
    return RepeatedRows(repeated, doubtful)


def _fill_empty_cells(rows: np.ndarray) -> np.ndarray:
    """Return rows (n, n_column) with empty cells filled from the row before or after; columns without any number are left out.

    A row is filled from a neighbour that is equal in the columns that both fill, if these are enough columns and not all zero.
    """
    rows = rows[:, np.isfinite(rows).any(axis=0)].copy()
    for direction in (1, -1):
        order = rows[::direction]  # a view: filled from the row before, then from the row after
        known = np.isfinite(order)
        shared = known[1:] & known[:-1]
        agree = (shared & (order[1:] != order[:-1])).sum(axis=1) == 0
        nonzero = (shared & (order[1:] != 0)).any(axis=1)
        enough = shared.sum(axis=1) >= SHARED * rows.shape[1]
        has_empty = ~known[1:].all(axis=1)
        for k in (np.flatnonzero(agree & nonzero & enough & has_empty) + 1).tolist():
            filled = np.where(known[k], order[k], order[k - 1])
            # the row before may have been filled meanwhile, so its new cells must agree as well
            shared_now = known[k] & np.isfinite(order[k - 1])
            if np.array_equal(order[k][shared_now], order[k - 1][shared_now]):
                order[k] = filled
    return rows


def _is_noisy(rows: np.ndarray) -> bool:
    """Return whether distinct rows (n, n_column), in steps of their resolution and in any order, contain noise.

    The test uses the darkest reading of each row, which without noise does not change.
    """
    darkest = np.where(np.isfinite(rows), rows, np.inf).min(axis=1, initial=np.inf)
    changes = np.abs(np.diff(darkest[np.isfinite(darkest)]))
    return len(changes) >= LEAST_PAIRS and bool(np.mean(changes >= NOISE_STEPS) > NOISY_SHARE)


def _find_periodic_pairs(rows: np.ndarray, equals_previous: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Return the indices of equal pairs whose neighbours agree as well, as in a rotation with a period of a whole number of
    samples.

    A copy of a frame, in contrast, has other neighbours than its original. `equals_previous` (n) are rows equal to the one before.
    """
    equal, distinct = np.flatnonzero(pairs.equal), np.flatnonzero(~equals_previous)
    readings = np.nan_to_num(rows[distinct])
    # places of the two samples of each pair among the distinct rows, where neighbours differ
    earlier, later = (
        np.searchsorted(distinct, each[equal]) for each in (pairs.earlier, pairs.later)
    )
    agree = np.ones(len(equal), dtype=bool)
    for step in (-1, 1):  # the neighbours before, then those after
        exists = (earlier + step >= 0) & (later + step < len(distinct))
        next_to_earlier = np.maximum(earlier + step, 0)
        next_to_later = np.minimum(later + step, len(distinct) - 1)
        apart = np.abs(readings[next_to_earlier] - readings[next_to_later]).max(axis=1, initial=0.0)
        change = np.abs(readings[next_to_later] - readings[later]).max(axis=1, initial=0.0)
        agree &= ~exists | (apart <= np.maximum(NOISE_STEPS, FOLLOWS * change))
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
    """Probability that two samples are equal by chance, as a function of their interval.

    `stretches`: for each, times (m) and readings (m, n_column), in steps of their resolution, of distinct samples; `least`: lower
    limit of the probability at any interval; `degrees_of_freedom` of the readings.
    """

    stretches: tuple[tuple[np.ndarray, np.ndarray], ...]
    least: float
    degrees_of_freedom: float = 2.0

    def at(self, interval: np.ndarray) -> np.ndarray:
        """Return the probability for each interval (m), s, rounded down to a power of `STEP`."""
        # intervals of the same power have one probability, which is computed once
        exponent = np.floor(np.log(np.maximum(interval, 1e-9)) / np.log(STEP))
        exponents, inverse = np.unique(exponent, return_inverse=True)
        each = np.array([self._at_interval(STEP**power) for power in exponents.tolist()])
        return np.maximum(each, self.least)[inverse.ravel()] if len(each) else np.zeros(0)

    def _at_interval(self, interval: float) -> float:
        """Return the probability for an interval (s): the mean over pairs of distinct samples about as far apart; 1 without pairs.

        The probability of a pair is d to the power -degrees_of_freedom. Here d is the largest difference of a column in steps,
        reduced in proportion to the interval for pairs farther apart than it, and at least 1.
        """
        shares = [np.zeros(0)]
        for t, rows in self.stretches:
            # the smallest number of samples, to a quarter, whose median distance is the interval
            lag, largest_lag = 1, len(t) // 2
            while lag < largest_lag and np.median(t[lag:] - t[:-lag]) < interval:
                lag = min(largest_lag, lag + max(1, lag // 4))
            apart = t[lag:] - t[:-lag]
            differ = np.abs(rows[lag:] - rows[:-lag])
            known = np.isfinite(differ).any(axis=1) & (apart > 0)
            largest = np.max(np.nan_to_num(differ[known]), axis=1, initial=0.0)
            scaled = largest * np.minimum(1.0, interval / apart[known])
            shares.append(np.maximum(scaled, 1.0) ** -self.degrees_of_freedom)
        every = np.concatenate(shares)
        return float(every.mean()) if len(every) else 1.0


def _chances(
    t: np.ndarray, rows: np.ndarray, stretch: np.ndarray, fresh: np.ndarray, least: float
) -> Iterator[tuple[np.ndarray, Chance]]:
    """Yield the samples (n) that are judged together, and their probability of chance repeats.

    Each stretch (`stretch` (n) is its number) is judged by its own distinct samples `fresh` (n). Stretches with too few of these
    are judged together, by those of the whole file. A stretch with a single distinct sample may be a body at rest and is not
    judged. `t` (n, s) and `rows` (n, n_column) are times and readings in steps of their resolution; `least` is that of `Chance`.
    """
    count = np.bincount(stretch, weights=fresh)
    distinct = {
        k: (t[(stretch == k) & fresh], rows[(stretch == k) & fresh])
        for k in np.flatnonzero(count > 1).tolist()
    }
    poor = [k for k in distinct if count[k] <= LEAST_PAIRS]
    for k in distinct:
        if k not in poor:
            yield stretch == k, Chance((distinct[k],), least)
    if poor and sum(len(times) - 1 for times, _ in distinct.values()) >= LEAST_PAIRS:
        yield np.isin(stretch, poor), Chance(tuple(distinct.values()), least)


def _recurrence(t: np.ndarray, same: np.ndarray, span_s: float) -> float:
    """Return the share of pairs of samples that are equal because readings are coarse or periodic.

    A value counts if it occurs over more than twice `span_s`, the largest interval between a frame and its copy. `same` (n) is the
    number of the value of each sample, `t` (n, s) its time.
    """
    order = np.lexsort((t, same))  # by value, then by time
    _, first, count = np.unique(same[order], return_index=True, return_counts=True)
    duration = t[order][first + count - 1] - t[order][first]
    equal = (count * (count - 1) / 2)[duration > 2 * span_s].sum()
    return float(equal / max(len(t) * (len(t) - 1) / 2, 1.0))


class Pairs(NamedTuple):
    """Pairs (m) of near samples with other samples in between: indices of the two, and whether their readings are equal."""

    earlier: np.ndarray
    later: np.ndarray
    equal: np.ndarray


def _find_near_pairs(
    t: np.ndarray, same: np.ndarray, equals_previous: np.ndarray, span_s: float
) -> Pairs:
    """Return the pairs of samples at most `span_s` apart with others in between, and whether their readings are equal.

    Pairs with equal readings may be a frame and its copy. `t` (n): times, s, increasing; `same` (n): number of the distinct
    readings of each sample. Samples that are equal to the one just before (`equals_previous`) are left out.
    """
    samples = np.flatnonzero(~equals_previous)
    earlier, later = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    # lag 1 would be neighbours: runs of equal samples are judged elsewhere
    for lag in range(2, min(MOST_BETWEEN, len(samples) - 1) + 1):
        near = t[samples[lag:]] - t[samples[:-lag]] <= span_s
        if not near.any():
            break
        earlier.append(samples[:-lag][near])
        later.append(samples[lag:][near])
    first, second = np.concatenate(earlier), np.concatenate(later)
    return Pairs(first, second, same[first] == same[second])


def _exceeds_chance(expected: float, count: int) -> bool:
    """Return whether `count` repeats are more than chance makes, if it makes `expected` on average (Poisson distribution).

    Chance must make as many in at most one file of a thousand, and a tenth of the repeats at most.
    """
    return (
        count > 0
        and expected <= MOST_RIGHT * count
        and bool(pdtrc(count - 1, SAFETY * expected) < BY_CHANCE)
    )


class RepeatCount(NamedTuple):
    """Repeats in one group of rows: how many chance makes on average among how many pairs, how many there are, and their rows."""

    expected: float
    pairs: int
    number: int
    rows: np.ndarray


def _beyond_chance_together(counts: list[RepeatCount]) -> np.ndarray:
    """Return the rows (m) that repeat others, of all groups together, if they are too many for chance; else none.

    A second ground station adds a copy or two to each pass: too few to judge one pass. Only groups count in which chance makes
    few repeats, whether there are any or not. So a slow stretch does not hide the copies of the others, and loses no row itself.
    """
    rare = [count for count in counts if count.expected <= MOST_RIGHT * count.pairs]
    expected, number = sum(count.expected for count in rare), sum(count.number for count in rare)
    if not rare or not _exceeds_chance(expected, number):
        return np.zeros(0, dtype=int)
    return np.concatenate([count.rows for count in rare])


def _runs_beyond_chance(
    t: np.ndarray, equals_previous: np.ndarray, adjacent: np.ndarray, chance: Chance
) -> np.ndarray:
    """Return the samples (n) that equal the one before not by chance: all if they are too many for chance, else those of long runs.

    The probability of a run is that of two equal samples as far apart as its ends, times a factor for each sample in between. The
    factor is the square root of the probability of equal neighbours. The square root allows for slow phases of a rotation, in which
    neighbours are not independent.

    Parameters
    ----------
    equals_previous : (n)
        Samples that are equal to the one before.
    adjacent : (n)
        Samples that directly follow the one before in the file.
    """
    by_run = np.zeros(len(t), dtype=bool)
    if not equals_previous.any():
        return by_run
    neighbours = np.flatnonzero(adjacent)
    equal_by_chance = chance.at(t[neighbours] - t[neighbours - 1])
    begins, ends = _runs(equals_previous)
    if _exceeds_chance(equal_by_chance.sum(), len(begins)):
        return equals_previous
    between = np.minimum(ends - begins - 1, MOST_COUNTED)
    run_by_chance = chance.at(t[ends] - t[begins]) * equal_by_chance.mean() ** (between / 2)
    for begin, end, probability in zip(begins, ends, run_by_chance, strict=True):
        if SAFETY * len(neighbours) * probability < BY_CHANCE:
            by_run[begin + 1 : end + 1] = True
    return by_run


def _runs(equals_previous: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last sample of each run of equal ones; the first does not equal the one before."""
    begins = np.flatnonzero(equals_previous & ~np.concatenate([[False], equals_previous[:-1]])) - 1
    ends = np.flatnonzero(equals_previous & ~np.concatenate([equals_previous[1:], [False]]))
    return begins, ends


def _from_two_stations(time: np.ndarray, value: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the samples (n) that equal the one before because another ground station received the same frame.

    A beacon sends at even intervals. Equal rows seconds apart, with longer intervals before and after, are one frame, if hardly any
    other neighbours so close differ. Chance does not show it, as a slow body would hardly turn within these seconds. But if a fast
    one is taken as slow between them, a wrong number of revolutions fits. Rows of dim light count too, those of zeros do not.

    `time` (n, s), `value` (n, n_column) and `usable` (n): as for :func:`find_repeated_rows`.
    """
    copies = np.zeros(len(time), dtype=bool)
    index = np.flatnonzero(usable)
    t, rows = time[index], np.where(np.isfinite(value[index]), value[index], NONE)
    known_light = ((rows != 0) & (rows != NONE)).any(axis=1)
    equals_previous = np.zeros(len(t), dtype=bool)
    equals_previous[1:] = (rows[1:] == rows[:-1]).all(axis=1) & known_light[1:]
    begins, ends = _runs(equals_previous)
    intervals = np.diff(t, prepend=-np.inf, append=np.inf)
    around = np.minimum(intervals[begins], intervals[ends + 1])
    duration = t[ends] - t[begins]
    close = np.isfinite(around) & (duration <= np.minimum(STATION_DELAY_S, APART * around))
    if not close.any():
        return copies
    others = ~equals_previous & (intervals[:-1] <= duration[close].max())
    if others.sum() <= MOST_RIGHT * close.sum():
        for begin, end in zip(begins[close], ends[close], strict=True):
            copies[index[begin + 1 : end + 1]] = True
    return copies


def _find_held_columns(time: np.ndarray, value: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Return the readings (n, n_panel) that a panel's column repeats although others change, if it does so throughout the file.

    `time` (n, s) and `value` (n, n_panel) are times and readings of all samples, `fresh` (n) the samples in which some panel has a
    new reading.
    """
    held = np.zeros(value.shape, dtype=bool)
    lit = value > LIT_SHARE * bright_reading(value)
    for k in range(value.shape[1]):
        samples = np.flatnonzero(fresh & lit[:, k])
        if len(samples) < 2 * LEAST_HELD:
            continue
        # from here on, only fresh samples in which panel k is lit
        t, column = time[samples], value[samples, k]
        adjacent = np.concatenate([[False], np.diff(np.cumsum(fresh)[samples]) == 1])
        equals_previous = adjacent & np.concatenate([[False], column[1:] == column[:-1]])
        # a sensor that holds its values repeats each about as often; a panel on the spin axis has one long run
        runs = np.diff(np.append(np.flatnonzero(~equals_previous), len(equals_previous)))
        if not 2 <= np.median(runs) or runs.max() > LONGEST_RUN * np.median(runs):
            continue
        step = resolution(column[:, None])
        # only differences within one lit stretch count
        lit_stretch = np.cumsum(~adjacent)
        distinct = tuple(
            (t[rows], column[rows, None] / step)
            for number in np.unique(lit_stretch)
            if (rows := (lit_stretch == number) & ~equals_previous).sum() > 1
        )
        n_held, n_pairs = int(equals_previous.sum()), sum(len(times) - 1 for times, _ in distinct)
        if n_pairs < LEAST_PAIRS or n_held < max(LEAST_HELD, HELD_SHARE * adjacent.sum()):
            continue
        # one column has one degree of freedom: a rotation brings its values back more often than a direction
        chance = Chance(distinct, least=0.0, degrees_of_freedom=1.0)
        neighbours = np.flatnonzero(adjacent)
        expected = chance.at(t[neighbours] - t[neighbours - 1]).sum()
        if _exceeds_chance(expected, n_held):
            held[samples[equals_previous], k] = True
    return held


def _has_signal(name: str, readings: np.ndarray) -> np.ndarray:
    """Return the samples (n) at which the sensor `name`, with readings (n, n_column), has a signal.

    For panels that is sunlight, for other sensors numbers that are not all zero.
    """
    if name != PANELS:
        return np.isfinite(readings).all(axis=1) & (readings != 0).any(axis=1)
    largest = np.where(np.isfinite(readings), readings, 0.0).max(axis=1, initial=0.0)
    return largest > LIT_SHARE * bright_reading(readings)
