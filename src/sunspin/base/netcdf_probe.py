"""Run as a script in another process: read all of NetCDF-4 files (paths, or standard input), and end well or not."""

import io
import sys
from typing import Any

LARGEST = 1_500_000_000
"""Bytes of one variable that are read; what is larger is left to the reader's own limit."""


def main() -> None:
    import h5netcdf
    import h5py

    for path in sys.argv[1:]:
        source = io.BytesIO(sys.stdin.buffer.read()) if path == "-" else path
        with h5py.File(source, "r") as file:
            require_whole(file, set())
        with h5netcdf.File(source, "r") as file:
            read(file)


def require_whole(group: Any, seen: set[Any]) -> None:
    """Refuse a file that takes data from other files: by an external link, external storage or a virtual variable."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
            raise ValueError("it takes data from another file")
        item = group.get(name)
        if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
            raise ValueError("it takes data from another file")
        if (
            isinstance(item, h5py.Group) and item.id not in seen
        ):  # a group may be linked into itself
            seen.add(item.id)
            require_whole(item, seen)


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
