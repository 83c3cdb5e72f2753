"""Run as a script in another process: read all of a NetCDF-4 file (a path, or standard input), and end well or not."""

import io
import sys
from typing import Any

LARGEST = 1_500_000_000
"""Bytes of one variable that are read; what is larger is left to the reader's own limit."""


def main() -> None:
    import h5netcdf

    source = io.BytesIO(sys.stdin.buffer.read()) if sys.argv[1] == "-" else sys.argv[1]
    with h5netcdf.File(source, "r") as file:
        read(file)


def read(group: Any) -> None:
    """Attributes, dimensions and values, as a reader would ask for them."""
    dict(group.attrs)
    list(group.dimensions.items())
    for variable in group.variables.values():
        dict(variable.attrs)
        size = variable.dtype.itemsize
        for length in variable.shape:
            size *= length
        if size < LARGEST:
            variable[...]
    for inner in group.groups.values():
        read(inner)


if __name__ == "__main__":
    main()
