"""Script for a separate process: read NetCDF-4 files completely, and end with an error if that fails."""

import math
import sys
from typing import Any

MAX_VARIABLE_BYTES = 1_500_000_000
"""Largest variable that is read here; larger ones are refused by the reader itself."""


def main() -> None:
    """Read all groups, attributes and variables of the files named on the command line.

    Raises ValueError for data in another file, and the errors of the HDF5 libraries.
    """
    import h5netcdf
    import h5py

    for path in sys.argv[1:]:
        with h5py.File(path, "r") as file:
            groups: list[Any] = [file]
            # the list grows while it is walked; a group may contain a link to itself
            for group in groups:
                for name in group:
                    is_outside = isinstance(group.get(name, getlink=True), h5py.ExternalLink)
                    item = None if is_outside else group.get(name)
                    is_data = isinstance(item, h5py.Dataset)
                    if is_outside or (is_data and (item.external or item.is_virtual)):
                        raise ValueError("it takes data from another file")
                    if isinstance(item, h5py.Group) and item not in groups:
                        groups.append(item)
        with h5netcdf.File(path, "r") as file:  # as xarray reads it
            nodes: list[Any] = [file]
            for group in nodes:
                dict(group.attrs)
                list(group.dimensions.items())
                for variable in group.variables.values():
                    dict(variable.attrs)
                    if math.prod(variable.shape) * variable.dtype.itemsize < MAX_VARIABLE_BYTES:
                        variable[...]
                nodes += group.groups.values()


if __name__ == "__main__":
    main()
