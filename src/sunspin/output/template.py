"""The example files that a user starts from."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

from sunspin.base.atomic_write import make_folder
from sunspin.base.errors import OutputError


def write_templates(folder: Path) -> list[Path]:
    """Write an example vehicle.toml and telemetry.csv into a folder and return their paths; write both or none.

    Raises
    ------
    OutputError
        One of the files exists, or the folder cannot be written.
    """
    source = resources.files("sunspin").joinpath("template")
    targets = [folder / name for name in ("vehicle.toml", "telemetry.csv")]
    for target in targets:
        if os.path.lexists(target):
            what, do = "this file is there already", "choose another folder"
            raise OutputError(what, do=do, where=str(target))
    created: list[Path] = []
    try:
        make_folder(folder)
        for target in targets:
            with open(target, "x", encoding="utf-8") as file:
                created.append(target)
                file.write(source.joinpath(target.name).read_text(encoding="utf-8"))
    except OSError as error:
        for target in created:
            target.unlink(missing_ok=True)
        what = f"files cannot be written here ({error.strerror or error})"
        raise OutputError(what, do="choose another folder", where=str(folder)) from None
    return targets
