"""Signs that the rows of a file are of several sources, or that its times or signs are not those of the samples."""

from __future__ import annotations

import re

import numpy as np

from sunspin.base.tables import TextTable

MANY_ROWS = 0.1
"""If more than this share of the rows have the time of the row before, the file has several sources, or its times are cut."""

SATELLITE_NAME = re.compile(
    r"(sat|satellite|spacecraft|norad|cospar|scid)[ _.-]?(cat[ _.-]?id|id|name|number|no)?"
)
"""The name, in small letters, of a column with the satellite of each row."""

ONE_SIDED = 0.02
"""All readings are negative if the largest one is at most this share of the size of the smallest."""


def describe_sources(
    table: TextTable, time: np.ndarray, unused: list[str], values: np.ndarray
) -> tuple[str, ...]:
    """Return sentences on rows of several sources, cut times and reversed signs; none for most files.

    Parameters
    ----------
    unused : list of str
        Columns that the vehicle file does not read.
    time : (n), s
        Times of the rows of the table, sorted. Rows with the same time contradict each other: others were merged before.
    values : (n, n_panel)
        Readings of the panels.
    """
    notes = []
    same = np.flatnonzero(np.diff(time) == 0)  # rows whose next row has the same time
    if len(same) > MANY_ROWS * len(time):
        cells = {name: table.cells[name].to_numpy() for name in unused}
        sources = [
            name for name, column in cells.items() if (column[same] != column[same + 1]).all()
        ]
        which = f" (column {sources[0]!r} differs)" if sources else ""
        notes.append(
            f"{len(same)} of {len(time)} rows have the time of the row before but other readings, and are not used: the file has "
            f"several sources{which}, or its times are cut, as spreadsheets cut seconds"
        )
    for name in unused:
        if not SATELLITE_NAME.fullmatch(name.strip().lower()):
            continue
        satellites = sorted({cell.strip() for cell in table.cells[name]} - {""})
        if len(satellites) > 1:
            shown = ", ".join(satellites[:3]) + ", ..." * (len(satellites) > 3)
            notes.append(
                f"column {name!r} has {len(satellites)} values ({shown}): keep the rows of one satellite"
            )
    known = values[np.isfinite(values)]
    if known.size and known.min() < 0 and known.max() <= ONE_SIDED * -known.min():
        notes.append("all panel readings are negative: give them with the other sign")
    return tuple(notes)
