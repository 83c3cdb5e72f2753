"""Run as a script in another process: read all of a NetCDF-4 file (a path, or standard input), and end well or not.

On damaged files the C library below may compute for ever or end the process; here that harms nobody.
"""

import io
import resource
import sys

MEMORY = 6_000_000_000
"""Bytes of address space."""


def main() -> None:
    path, seconds = sys.argv[1], int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import h5netcdf

    source = io.BytesIO(sys.stdin.buffer.read()) if path == "-" else path
    with h5netcdf.File(source, "r") as file:
        _read(file)


def _read(group) -> None:
    """Attributes, dimensions and values, as a reader would ask for them; values of absurd size are left to the reader's limit."""
    dict(group.attrs)
    list(group.dimensions.items())
    for variable in group.variables.values():
        dict(variable.attrs)
        size = 1
        for length in variable.shape:
            size *= length
        if size * variable.dtype.itemsize < MEMORY // 4:
            variable[...]
    for inner in group.groups.values():
        _read(inner)


if __name__ == "__main__":
    try:
        main()
    except Exception as error:
        sys.exit(f"{type(error).__name__}: {error}")
