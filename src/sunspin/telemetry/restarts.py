"""Clocks that jump: uptime that starts again after a reset, and local clocks that are set back.

Rows that are merely out of order are distinguished from a reset: frames that arrive late belong to an earlier boot, a frame
received by two stations repeats its readings, and telemetry stored on board fills gaps. After a reset, times that are already known
occur again with other readings.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

USUAL_DELAY_S = 60.0
"""Usual delay from a sample to its reception by a station; with a longer delay the telemetry was stored on board. SatNOGS and the
skCUBE collector stamp frames within seconds. The rest allows for rounded stamps and for samples taken before their beacon."""

SAME_RATE = 0.3
"""Live telemetry has a constant delay (received time minus uptime). In a playback, which is faster or slower, the delay changes by
more than this share of the change of uptime (in a burst by all of it)."""

MOST_COMPARED = 2000
"""Largest number of rows from which the rate of uptime is estimated."""

FALL_INTERVALS = 3.0
"""Times that fall back by no more than this many sampling intervals are frames that arrived out of order."""

DENSE = 1.5
"""Between two samples no farther apart than this many median intervals, no sample is missing."""

SAME_TIME = 0.05
"""Samples closer than this share of the median interval have the same time."""

FEWEST_BETWEEN, SHARE_BETWEEN = 3, 0.5
"""A stretch runs through known times again if at least so many of its samples lie where no sample is missing. They must also be at
least this share of its samples within the known times."""

QUARTER_S = 900.0
"""A quarter hour: local clocks differ by whole multiples of it."""

STORED_LONG_S = 86_400.0
"""Telemetry is seldom stored for longer than a day. A longer delay that also exceeds the uptime reached so far is a new boot
even if no row of it was received live."""

FIRST_UPTIME_S = 6000.0
"""After a reset in view of a station the first uptime is below one orbit. Rows that run through known times again from a later
uptime may be stored telemetry. Of 363 correct simulated files with playbacks, 3 are rejected, and 8 if a day is allowed."""

STEPS_IN_QUARTERS = (1, 2, 3, 4, 8, 12)
"""Steps of a local clock, in quarter hours: daylight saving is one hour (half an hour on Lord Howe Island, two at Troll), and a
wrong zone may be corrected. A playback goes back by any time, which is seldom one of these. Of 363 simulated files with playbacks,
2 match one of these steps; 4 match some multiple of a quarter hour up to three hours."""

LONGEST_FALL_S = 3 * 3600.0
"""A single fall of local times by up to this may be a step with samples missing around it."""

MOST_STRAGGLERS = 3
"""Largest number of consecutive rows that may be late or early in a file that is otherwise in order."""

MANY_FALLS = 0.1
"""If times fall at more than this share of the rows, a single fall is no evidence of a step."""

MONTHS_S = 60 * 86_400.0
"""Clocks are set back in autumn: two falls within this time have another cause."""

NEXT_PASS = 10.0
"""The rows after a fall are compared up to a gap of this many median intervals, because the rows after it may be of any later
pass."""

ROUNDED_S = 1.0
"""Times may be rounded to this."""


class Restart(NamedTuple):
    """A row at which times start again.

    `row`: its number in the file; `before`: number of the row before it; `back_s`: how far times fall; `sure`: False if rows out of
    order could explain the fall.
    """

    row: int
    before: int
    back_s: float
    sure: bool = True


class Frames(NamedTuple):
    """Contents of the rows (n) of a file without their times: cells (n, n_column) of the columns that are read, as stripped
    text."""

    cells: np.ndarray

    def agree(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return whether rows `first` (m) and rows `second` (m) are equal in all columns that both fill."""
        left, right = self.cells[first], self.cells[second]
        return ((left == right) | (left == "") | (right == "")).all(axis=1)

    def comparable(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return whether rows `first` (m) and rows `second` (m) have at least one column that both fill."""
        return ((self.cells[first] != "") & (self.cells[second] != "")).any(axis=1)

    def repeated(self, time: np.ndarray, order: np.ndarray) -> np.ndarray:
        """Return whether each row (n) has the time and the cells of a row that comes earlier in `order` (n)."""
        seen: set[tuple] = set()
        repeated = np.zeros(len(time), dtype=bool)
        for i in order.tolist():
            key = (float(time[i]), *self.cells[i].tolist())
            repeated[i] = key in seen
            seen.add(key)
        return repeated


def find_boot_starts(uptime: np.ndarray, received: np.ndarray, frames: Frames) -> np.ndarray:
    """Return the instant of uptime zero of each boot (s, on the clock of `received`, ascending), from the delays received - uptime.

    A boot begins after the last sample of the boot before it. At a new boot, the delay therefore grows by at least the uptime
    reached so far. A late downlink would also need a delay as long as that. In addition, the uptime of a late downlink does not
    advance at the rate of the received time, as that of live telemetry does.

    Parameters
    ----------
    uptime, received : array (n)
        In s; `received` is NaN for a row without a received time.
    """
    known = np.flatnonzero(np.isfinite(received))
    delay = (received - uptime)[known]
    if np.ptp(delay) <= USUAL_DELAY_S:
        return delay.min(keepdims=True)
    order = known[np.argsort(received[known], kind="stable")]
    order = order[~frames.repeated(uptime, order)[order]]  # each frame at its first reception
    delay = (received - uptime)[order]
    by_delay = np.argsort(delay, kind="stable")
    up, heard, delay = uptime[order][by_delay], received[order][by_delay], delay[by_delay]
    # `starts`: first row of each boot; `begin`, `latest`: uptime zero and last sample of this boot, on the clock of `received`
    starts, begin, latest = [0], delay[0], -np.inf
    ends = np.searchsorted(delay, delay + USUAL_DELAY_S, "right")
    for k in range(len(delay)):
        # the delay is the instant of uptime zero, if the row was received live: then it must follow the last sample
        begins_later = delay[k] - begin > USUAL_DELAY_S and delay[k] >= latest - USUAL_DELAY_S
        of_like_delay = slice(k, ends[k])
        if begins_later and (
            delay[k] - begin > STORED_LONG_S
            or _is_live(up, heard, delay, of_like_delay, slice(starts[-1], k))
        ):
            starts.append(k)
            begin, latest = delay[k], -np.inf
        latest = max(latest, begin + up[k])
    return delay[starts]


def _is_live(
    uptime: np.ndarray, heard: np.ndarray, delay: np.ndarray, rows: slice, before: slice
) -> bool:
    """Return whether `rows`, of nearly the same delay, were received live.

    A single row counts as live if it is the last one received and most rows of the boot `before` are live.

    Parameters
    ----------
    uptime, heard, delay : (n), s
        Uptime, received time and their difference, of all rows in the order of the delay.
    rows, before : slice
        Ranges of these arrays.
    """
    if rows.stop - rows.start == 1:
        is_last = rows.stop == len(delay) and heard[rows.start] == heard.max()
        live_share = np.mean(delay[before] - delay[before.start] <= USUAL_DELAY_S)
        return bool(is_last and live_share > 0.5)
    return _has_constant_delay(uptime[rows][:MOST_COMPARED], delay[rows][:MOST_COMPARED])


def _has_constant_delay(uptime: np.ndarray, delay: np.ndarray) -> bool:
    """Return whether the delay (m) does not change with uptime (m), unlike in a playback; False if all uptimes are equal."""
    spread = np.var(uptime)
    if spread == 0:
        return False
    slope = np.mean((uptime - uptime.mean()) * (delay - delay.mean())) / spread
    return bool(abs(slope) < SAME_RATE)


def has_live_rows(uptime: np.ndarray, received: np.ndarray) -> bool:
    """Return whether the rows of a boot (m) with the smallest delays were received live."""
    known = np.isfinite(received)
    uptime, delay = uptime[known], (received - uptime)[known]
    smallest = delay <= delay.min(initial=np.inf) + USUAL_DELAY_S
    if not smallest.any():  # no row has a received time
        return False
    return _has_constant_delay(uptime[smallest], delay[smallest])


def assign_boots(uptime: np.ndarray, received: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the number of the boot of each row (n): the last boot of `starts` that had begun `uptime` before the reception.

    `starts` are the instants of uptime zero (s, ascending, on the clock of `received`). `received` is NaN for a row without a time.
    A row without a received time gets the boot of the dated row before or after it in the file, whichever has the nearer uptime.
    """
    known = np.flatnonzero(np.isfinite(received))
    boot = np.zeros(len(uptime), dtype=int)
    zero = (received - uptime)[known] + 1e-6  # a microsecond more: the tolerance for rounding
    boot[known] = np.maximum(np.searchsorted(starts, zero, "right") - 1, 0)
    for i in np.flatnonzero(~np.isfinite(received)).tolist():
        k = int(np.searchsorted(known, i))
        neighbours = known[max(k - 1, 0) : k + 1]
        boot[i] = boot[neighbours[np.argmin(np.abs(uptime[neighbours] - uptime[i]))]]
    return boot


def estimate_boot_epochs(
    uptime: np.ndarray, received: np.ndarray, boot: np.ndarray, count: int
) -> np.ndarray:
    """Return the instant of uptime zero (count, s) of each boot, on the clock of `received`; NaN for a boot without a received
    time.

    It is the median of received - uptime over the rows with nearly the smallest delay, which were not stored on board.
    """
    epochs = np.full(count, np.nan)
    for k in range(count):
        delay = (received - uptime)[(boot == k) & np.isfinite(received)]
        if delay.size:
            epochs[k] = np.median(delay[delay <= delay.min() + USUAL_DELAY_S])
    return epochs


def find_uptime_restart(uptime: np.ndarray, frames: Frames) -> Restart | None:
    """Return the first row from which uptime (n) runs through known values again with other readings.

    If there is none, return a row that may be the first after a reset, with `sure` False. None if there is no such row either.
    """
    if not np.any(np.diff(uptime) < 0):
        return None
    order, median_interval = _order_oldest_first(uptime)
    falls = _find_falls(uptime[order], median_interval)
    for fall, end in pairwise([*falls, len(order)]):
        if _repeats_known_times(uptime, frames, order[:fall], order[fall:end]):
            row, before = order[fall], order[fall - 1]
            back = float(uptime[before] - uptime[row])
            return Restart(int(row), int(before), back, bool(uptime[row] < FIRST_UPTIME_S))
    # no fall is certain: look for one that a reset would make, with a small first uptime or by more than telemetry is stored for
    repeated = frames.repeated(uptime, order)
    for fall in falls:
        row, before = order[fall], order[fall - 1]
        back = float(uptime[before] - uptime[row])
        if (back > STORED_LONG_S or uptime[row] < FIRST_UPTIME_S) and not repeated[row]:
            return Restart(int(row), int(before), back, sure=False)
    return None


def find_clock_set_back(time: np.ndarray, frames: Frames, local: bool) -> Restart | None:
    """Return the row from which on times (n, s) are those of a clock that was set back; None if there is no such row.

    The `back_s` of the result is the step of the clock if it is one of `STEPS_IN_QUARTERS`, else how far times fall.

    A few late or early rows are left out. The file is cut at each row before which all rows are earlier than all rows after. A fall
    is tested if it is the only one of its part. Its size must be a step of a local clock, less one interval between samples. Times
    must also occur twice, as they do not in blocks of rows that are out of order.

    Times without a zone (`local`) have weaker conditions. Some samples may be missing at the step. Times need not occur twice if
    all falls of the file are equal and months apart, or if known times occur again with other readings. Another single fall may be
    a step as well; it is returned with `sure` False.
    """
    if not np.any(np.diff(time) < 0):
        return None
    order, median_interval = _order_oldest_first(time)
    order = order[~frames.repeated(time, order)[order]]
    n_backward = np.count_nonzero(np.diff(time[order]) < 0)
    if len(_find_falls(time[order], median_interval)) != 1 and n_backward > MANY_FALLS * len(order):
        return None  # the file is in disorder
    order = order[_drop_stragglers(time[order], median_interval)]
    steps = np.diff(time[order])
    steps = steps[(steps > 0) & (steps <= FALL_INTERVALS * median_interval)]
    if not steps.size:
        return None
    # limits of the interval between the last sample before the step and the first one after it
    shortest, longest = max(steps.min() - np.ptp(steps), 0.0), steps.max() + np.ptp(steps)
    if local:  # some samples may be missing at the step
        longest = max(longest, FALL_INTERVALS * median_interval)
    n_falls = len(_find_falls(time[order], median_interval))
    clock_steps: list[
        Restart
    ] = []  # falls by a step of a local clock, whose times do not occur twice
    other_falls: list[Restart] = []
    for part in _split_in_order(time, order):
        falls = _find_falls(time[part], median_interval)
        # at least two rows on each side of the fall show the order of the times there
        if len(falls) != 1 or not 2 <= falls[0] <= len(part) - 2:
            continue
        known, later = part[: falls[0]], part[falls[0] :]
        row, before = int(later[0]), int(known[-1])
        back = float(time[before] - time[row])
        # the clock's step is the fall plus the interval between the two samples: the longest interval gives the most quarter hours
        quarters = int((back + longest + ROUNDED_S) // QUARTER_S)
        is_clock_step = (
            QUARTER_S * quarters >= back + shortest - ROUNDED_S and quarters in STEPS_IN_QUARTERS
        )
        size = QUARTER_S * quarters if is_clock_step else back
        if (is_clock_step and _overlap(time[known], time[later])) or (
            local and n_falls == 1 and _repeats_known_times(time, frames, known, later)
        ):
            return Restart(row, before, size)
        if is_clock_step:
            clock_steps.append(Restart(row, before, size))
        elif local and back <= LONGEST_FALL_S:
            other_falls.append(Restart(row, before, size, sure=False))
    apart = np.diff([time[step.row] for step in clock_steps])
    yearly = len({step.back_s for step in clock_steps}) == 1 and (apart > MONTHS_S).all()
    if local and len(clock_steps) == n_falls and yearly:
        return clock_steps[0]
    candidates = [step._replace(sure=False) for step in clock_steps] + other_falls
    return candidates[0] if n_falls == 1 and candidates else None


def _drop_stragglers(time: np.ndarray, median_interval: float) -> np.ndarray:
    """Return the indices of times (n, in the file's order) without blocks of up to `MOST_STRAGGLERS` late or early rows."""
    rows = np.arange(len(time))
    for count in range(1, MOST_STRAGGLERS + 1):
        t, drop = time[rows], np.zeros(len(rows), dtype=bool)
        falls = _find_falls(t, median_interval)
        # a block of `count` rows is late if times go on after it as before, early if they do so before it
        falls = falls[(falls > count) & (falls + count < len(t))]
        late = t[falls + count] >= t[falls - 1]
        early = ~late & (t[falls] >= t[falls - count - 1])
        for k in range(count):
            drop[falls[late] + k] = True
            drop[falls[early] - 1 - k] = True
        rows = rows[~drop]
    return rows


def _split_in_order(time: np.ndarray, order: np.ndarray) -> list[np.ndarray]:
    """Return the rows in `order`, split wherever all rows before are earlier than all rows after."""
    t = time[order]
    earliest_from_here = np.minimum.accumulate(t[::-1])[::-1]
    cuts = np.flatnonzero(np.maximum.accumulate(t)[:-1] < earliest_from_here[1:]) + 1
    return np.split(order, cuts)


def _overlap(known: np.ndarray, later: np.ndarray) -> bool:
    """Return whether enough `later` times (s) lie between two successive `known` times that have no missing sample in between."""
    known = np.unique(known)
    if len(known) < FEWEST_BETWEEN:
        return False
    steps = np.diff(known)
    after = np.searchsorted(known, later)
    within = after[(after > 0) & (after < len(known))]
    dense = steps[within - 1] <= DENSE * np.median(steps)
    return int(np.count_nonzero(dense)) >= FEWEST_BETWEEN


def _order_oldest_first(time: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rows (n) in the file's order, reversed if most times fall, and the median interval (s).

    The median is taken over the intervals between successive rows, in either direction, without zeros; 0 if all times are equal.
    """
    steps = np.diff(time)
    order = np.arange(len(time))
    if np.count_nonzero(steps < 0) > np.count_nonzero(steps > 0):
        order = order[::-1]
    intervals = np.abs(steps[steps != 0])
    return order, float(np.median(intervals)) if intervals.size else 0.0


def _find_falls(time: np.ndarray, median_interval: float) -> np.ndarray:
    """Return the rows at which times fall back by more than frames out of order do (`FALL_INTERVALS` median intervals)."""
    return np.flatnonzero(np.diff(time) < -FALL_INTERVALS * median_interval) + 1


def _repeats_known_times(
    time: np.ndarray, frames: Frames, known: np.ndarray, later: np.ndarray
) -> bool:
    """Return whether rows `later` run through the times of rows `known` again, with other readings of the same columns.

    A later row counts if it contradicts a known row of the same time, or lies between two known rows without a missing sample.
    """
    known = known[np.argsort(time[known], kind="stable")]
    if len(known) < FEWEST_BETWEEN or len(later) < FEWEST_BETWEEN:
        return False
    t = time[known]
    median_interval = float(np.median(np.diff(np.unique(t)))) if len(np.unique(t)) > 1 else 0.0
    # the later rows up to their first long gap
    long_gap = np.append(np.diff(time[later]) > NEXT_PASS * median_interval, True)
    later = later[: int(np.argmax(long_gap)) + 1]
    within = later[(time[later] >= t[0]) & (time[later] <= t[-1])]
    # the known rows before and after each of these, and the nearer of the two
    after = np.clip(np.searchsorted(t, time[within]), 1, len(t) - 1)
    low, high = known[after - 1], known[after]
    dense = time[high] - time[low] <= DENSE * median_interval
    nearer = np.where(time[within] - time[low] < time[high] - time[within], low, high)
    same_time = np.abs(time[within] - time[nearer]) <= SAME_TIME * median_interval
    contradicts = np.where(same_time, ~frames.agree(within, nearer), dense)
    contradicts &= frames.comparable(within, nearer)
    count = int(np.count_nonzero(contradicts))
    return count >= FEWEST_BETWEEN and count >= SHARE_BETWEEN * len(within)
