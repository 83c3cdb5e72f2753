"""Clocks that jump: uptime that starts again after a reset, and local clocks that are set back.

Rows that are merely out of order are told apart by what a reset cannot do, and by what a reset alone does. Late downlinks keep the
boot they come from; the same frame heard by two stations repeats its readings; stored telemetry fills gaps.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

USUAL_DELAY_S = 60.0
"""From a sample to its reception by a station that listens; more is telemetry that was stored. SatNOGS and the skCUBE
collector stamp frames within seconds; the rest is for rounded stamps and for samples taken before the beacon that brings them."""

SAME_RATE = 0.3
"""While a station listens, uptime and received time advance at one rate. A playback is faster or slower: received minus
uptime then changes by more than this part of the uptime (a burst: by all of it)."""

MOST_COMPARED = 2000
"""Rows compared to see at what rate uptime advances."""

FALL_INTERVALS = 3.0
"""Times that fall back by no more than this many sampling intervals are frames that arrived out of order."""

DENSE = 1.5
"""Between two samples no farther apart than this many usual intervals, no sample is missing."""

SAME_TIME = 0.05
"""Samples closer than this part of the usual interval are of one time."""

FEWEST_BETWEEN, SHARE_BETWEEN = 3, 0.5
"""A stretch ran through known times again if at least so many of its samples lie where none is missing, and this part of those
within the known times."""

QUARTER_S = 900.0
"""A quarter hour: local clocks differ by whole multiples of it."""

STORED_LONG_S = 86_400.0
"""Telemetry is seldom stored for longer than a day. A longer delay that also exceeds the uptime reached so far is a new boot
even if no row of it was received at once."""

FIRST_UPTIME_S = 6000.0
"""After a reset in view of a station the first uptime is below one orbit. Rows that run through known times again from a later
one may be stored telemetry: of 363 simulated right files with playbacks 3 are accused, and 8 if a day is allowed."""

STEPS_IN_QUARTERS = (1, 2, 3, 4, 8, 12)
"""Steps of a local clock, in quarter hours: daylight saving is one hour (half an hour on Lord Howe Island, two at Troll), and
somebody may correct a wrong zone. A playback of stored telemetry goes back by any time, which seldom is one of these: with all
multiples up to three hours 4 of 363 simulated files with playbacks met one, with these 2."""

LONGEST_FALL_S = 3 * 3600.0
"""A single fall of local times by up to this may be a step with samples missing around it."""

MOST_STRAGGLERS = 3
"""So many rows that follow each other may be late or early in a file that is otherwise in order."""

MANY_FALLS = 0.1
"""If times fall at more than this part of the rows, a fall among several says nothing."""

MONTHS_S = 60 * 86_400.0
"""A clock is set back in autumn: twice within this is something else."""

NEXT_PASS = 10.0
"""The rows after a fall are compared up to a gap of this many usual intervals: what follows may be any later pass."""

ROUNDED_S = 1.0
"""Times may be rounded to this."""


class Restart(NamedTuple):
    """A row of the file at which times start again, the row before it, by how much they fall (s), and whether that is
    sure."""

    row: int
    before: int
    back_s: float
    sure: bool = True


class Frames(NamedTuple):
    """What the rows (n) of a file hold besides their times: cells (n, n_column) that are read, as text, stripped."""

    cells: np.ndarray

    def alike(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return whether rows (m) hold nothing that contradicts other rows (m)."""
        left, right = self.cells[first], self.cells[second]
        return ((left == right) | (left == "") | (right == "")).all(axis=1)

    def comparable(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return whether rows (m) fill some column that other rows (m) fill too."""
        return ((self.cells[first] != "") & (self.cells[second] != "")).any(axis=1)

    def repeated(self, time: np.ndarray, order: np.ndarray) -> np.ndarray:
        """Return whether each row (n) has the time and the cells of a row that comes earlier in `order` (n)."""
        seen: set[tuple] = set()
        again = np.zeros(len(time), dtype=bool)
        for i in order.tolist():
            key = (float(time[i]), *self.cells[i].tolist())
            again[i] = key in seen
            seen.add(key)
        return again


def boot_starts(uptime: np.ndarray, received: np.ndarray, frames: Frames) -> np.ndarray:
    """Return when each boot had uptime zero (s, on the clock of `received`, ascending), by the delays received - uptime.

    A boot cannot begin before the last sample of the boot before it was taken. Hence a new boot begins where the delay grows by at
    least the uptime reached so far. A late downlink alone would need a delay as long as that. Its uptime would also not advance
    at the rate of the received time, as that of a boot does while a station listens.

    Parameters
    ----------
    uptime, received : array (n)
        In s; NaN where a row has no received time.
    """
    known = np.flatnonzero(np.isfinite(received))
    delay = (received - uptime)[known]
    if np.ptp(delay) <= USUAL_DELAY_S:
        return delay.min(keepdims=True)
    order = known[np.argsort(received[known], kind="stable")]
    order = order[~frames.repeated(uptime, order)[order]]
    delay = (received - uptime)[order]
    by_delay = np.argsort(delay, kind="stable")
    up, heard, delay = uptime[order][by_delay], received[order][by_delay], delay[by_delay]
    ends = np.searchsorted(delay, delay + USUAL_DELAY_S, "right")
    starts, begin = [0], delay[0]
    latest = -np.inf  # when the last sample of this boot was taken
    for k in range(len(delay)):
        grown = delay[k] - begin > USUAL_DELAY_S and delay[k] >= latest - USUAL_DELAY_S
        here = slice(k, ends[k])
        if grown and (
            delay[k] - begin > STORED_LONG_S
            or _listened(up, heard, delay, here, slice(starts[-1], k))
        ):
            starts.append(k)
            begin, latest = delay[k], -np.inf
        latest = max(latest, begin + up[k])
    return delay[starts]


def _listened(
    uptime: np.ndarray, heard: np.ndarray, delay: np.ndarray, rows: slice, before: slice
) -> bool:
    """Return whether rows of nearly one delay were received while they were sampled; a single one, if it is the file's last and
    those before it were."""
    up, late = uptime[rows][:MOST_COMPARED], delay[rows][:MOST_COMPARED]
    if len(up) == 1:
        last = rows.stop == len(delay) and heard[rows.start] == heard.max()
        usual = np.mean(delay[before] - delay[before.start] <= USUAL_DELAY_S)
        return bool(last and usual > 0.5)
    return _one_rate(up, late)


def _one_rate(uptime: np.ndarray, delay: np.ndarray) -> bool:
    """Return whether the delay of rows (m) does not change with uptime as in a playback."""
    spread = np.var(uptime)
    if spread == 0:
        return False
    slope = np.mean((uptime - uptime.mean()) * (delay - delay.mean())) / spread
    return bool(abs(slope) < SAME_RATE)


def received_live(uptime: np.ndarray, received: np.ndarray) -> bool:
    """Return whether the rows (m) of a boot with the least delays were received while they were sampled."""
    delay = (received - uptime)[np.isfinite(received)]
    least = delay <= delay.min(initial=np.inf) + USUAL_DELAY_S
    return bool(least.any()) and _one_rate(uptime[np.isfinite(received)][least], delay[least])


def boots_of(uptime: np.ndarray, received: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the number (n) of each row's boot: the last that had begun when it was received with its uptime. A row without a
    received time belongs to the boot of the row before or after it in the file, whose uptime is nearer."""
    known = np.flatnonzero(np.isfinite(received))
    boot = np.zeros(len(uptime), dtype=int)
    boot[known] = np.maximum(
        np.searchsorted(starts, (received - uptime)[known] + 1e-6, "right") - 1, 0
    )
    for i in np.flatnonzero(~np.isfinite(received)).tolist():
        k = int(np.searchsorted(known, i))
        near = known[max(k - 1, 0) : k + 1]
        boot[i] = boot[near[np.argmin(np.abs(uptime[near] - uptime[i]))]]
    return boot


def boot_epochs(
    uptime: np.ndarray, received: np.ndarray, boot: np.ndarray, count: int
) -> np.ndarray:
    """Return when each boot had uptime zero (count, s): the median of received - uptime over rows received without being stored,
    or NaN for a boot without a received time."""
    epochs = np.full(count, np.nan)
    for k in range(count):
        delay = (received - uptime)[(boot == k) & np.isfinite(received)]
        if delay.size:
            epochs[k] = np.median(delay[delay <= delay.min() + USUAL_DELAY_S])
    return epochs


def uptime_restart(uptime: np.ndarray, frames: Frames) -> Restart | None:
    """Return the first row from which uptime (n) runs through known values again with other readings; else a row that may be the
    first after a reset, which is not sure; None without either."""
    if not np.any(np.diff(uptime) < 0):
        return None
    order, usual = _forward(uptime)
    falls = _falls(uptime[order], usual)
    for fall, end in pairwise([*falls, len(order)]):
        if _runs_again(uptime, frames, order[:fall], order[fall:end]):
            row, before = order[fall], order[fall - 1]
            back = float(uptime[before] - uptime[row])
            return Restart(int(row), int(before), back, bool(uptime[row] < FIRST_UPTIME_S))
    again = frames.repeated(uptime, order)
    for fall in falls:
        row, before = order[fall], order[fall - 1]
        back = float(uptime[before] - uptime[row])
        if (back > STORED_LONG_S or uptime[row] < FIRST_UPTIME_S) and not again[row]:
            return Restart(int(row), int(before), back, sure=False)
    return None


def clock_set_back(time: np.ndarray, frames: Frames, local: bool) -> Restart | None:
    """Return the row from which later times (n, s) are those of a clock that was set back; None if there is no such row.

    A few rows late or early are left out. The file is cut where all rows before are earlier than all rows after, and a fall that is
    the only one of its part is tested. It is a whole number of quarter hours, less one interval between samples. Times must also
    occur twice, as blocks out of order do not.

    Of `local` times (no zone) some samples may be missing at the step. They need not occur twice if all falls of the file are alike
    and months apart. They may also run through known times again with other readings. A different single fall may be a step, but is
    not sure.
    """
    if not np.any(np.diff(time) < 0):
        return None
    order, usual = _forward(time)
    order = order[~frames.repeated(time, order)[order]]
    disorder = np.count_nonzero(np.diff(time[order]) < 0)
    if len(_falls(time[order], usual)) != 1 and disorder > MANY_FALLS * len(order):
        return None
    order = order[_without_stragglers(time[order], usual)]
    steps = np.diff(time[order])
    steps = steps[(steps > 0) & (steps <= FALL_INTERVALS * usual)]
    if not steps.size:
        return None
    shortest, longest = max(steps.min() - np.ptp(steps), 0.0), steps.max() + np.ptp(steps)
    if local:  # some samples may be missing at the step
        longest = max(longest, FALL_INTERVALS * usual)
    n_falls, whole, unsure = len(_falls(time[order], usual)), [], []
    for part in _parts_in_order(time, order):
        falls = _falls(time[part], usual)
        if len(falls) != 1 or not 2 <= falls[0] <= len(part) - 2:
            continue
        known, later = part[: falls[0]], part[falls[0] :]
        row, before = int(later[0]), int(known[-1])
        back = float(time[before] - time[row])
        quarters = int((back + longest + ROUNDED_S) // QUARTER_S)
        fits = QUARTER_S * quarters >= back + shortest - ROUNDED_S and quarters in STEPS_IN_QUARTERS
        size = QUARTER_S * quarters if fits else back
        if (fits and _overlap(time[known], time[later])) or (
            local and n_falls == 1 and _runs_again(time, frames, known, later)
        ):
            return Restart(row, before, size)
        if fits:
            whole.append(Restart(row, before, size))
        elif local and back <= LONGEST_FALL_S:
            unsure.append(Restart(row, before, size, sure=False))
    apart = np.diff([time[each.row] for each in whole])
    alike = len({each.back_s for each in whole}) == 1 and (apart > MONTHS_S).all()
    if local and len(whole) == n_falls and alike:
        return whole[0]
    maybe = [each._replace(sure=False) for each in whole] + unsure
    return maybe[0] if n_falls == 1 and maybe else None


def _without_stragglers(time: np.ndarray, usual: float) -> np.ndarray:
    """Return the rows (n, times in the file's order) without a few that are late or early among others in order."""
    rows = np.arange(len(time))
    for count in range(1, MOST_STRAGGLERS + 1):
        t, drop = time[rows], np.zeros(len(rows), dtype=bool)
        falls = _falls(t, usual)
        falls = falls[(falls > count) & (falls + count < len(t))]
        late = t[falls + count] >= t[falls - 1]
        early = ~late & (t[falls] >= t[falls - count - 1])
        for k in range(count):
            drop[falls[late] + k] = True
            drop[falls[early] - 1 - k] = True
        rows = rows[~drop]
    return rows


def _parts_in_order(time: np.ndarray, order: np.ndarray) -> list[np.ndarray]:
    """Return rows in `order`, cut where all before are earlier than all after."""
    t = time[order]
    least_after = np.minimum.accumulate(t[::-1])[::-1]
    cuts = np.flatnonzero(np.maximum.accumulate(t)[:-1] < least_after[1:]) + 1
    return np.split(order, cuts)


def _overlap(known: np.ndarray, later: np.ndarray) -> bool:
    """Return whether `later` times lie between `known` ones where no sample is missing."""
    known = np.unique(known)
    if len(known) < FEWEST_BETWEEN:
        return False
    steps = np.diff(known)
    after = np.searchsorted(known, later)
    within = after[(after > 0) & (after < len(known))]
    dense = steps[within - 1] <= DENSE * np.median(steps)
    return int(np.count_nonzero(dense)) >= FEWEST_BETWEEN


def _forward(time: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rows (n) in the file's order, or against it if most times fall, and the usual interval (s)."""
    steps = np.diff(time)
    order = np.arange(len(time))
    if np.count_nonzero(steps < 0) > np.count_nonzero(steps > 0):
        order = order[::-1]
    moved = np.abs(steps[steps != 0])
    return order, float(np.median(moved)) if moved.size else 0.0


def _falls(time: np.ndarray, usual: float) -> np.ndarray:
    """Return the rows at which times fall back by more than frames that arrive out of order do."""
    return np.flatnonzero(np.diff(time) < -FALL_INTERVALS * usual) + 1


def _runs_again(time: np.ndarray, frames: Frames, known: np.ndarray, later: np.ndarray) -> bool:
    """Return whether `later` rows run through the times of `known` rows with other readings of the same columns, where none is
    missing."""
    known = known[np.argsort(time[known], kind="stable")]
    if len(known) < FEWEST_BETWEEN or len(later) < FEWEST_BETWEEN:
        return False
    t, again = time[known], time[later]
    usual = float(np.median(np.diff(np.unique(t)))) if len(np.unique(t)) > 1 else 0.0
    later = later[: int(np.argmax(np.append(np.diff(again) > NEXT_PASS * usual, True))) + 1]
    within = later[(time[later] >= t[0]) & (time[later] <= t[-1])]
    after = np.clip(np.searchsorted(t, time[within]), 1, len(t) - 1)
    low, high = known[after - 1], known[after]
    dense = time[high] - time[low] <= DENSE * usual
    nearer = np.where(time[within] - time[low] < time[high] - time[within], low, high)
    one_time = np.abs(time[within] - time[nearer]) <= SAME_TIME * usual
    other = np.where(one_time, ~frames.alike(within, nearer), dense)
    other &= frames.comparable(within, nearer)
    count = int(np.count_nonzero(other))
    return count >= FEWEST_BETWEEN and count >= SHARE_BETWEEN * len(within)
