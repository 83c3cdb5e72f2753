"""`sunspin compare`."""

from __future__ import annotations

import click

from sunspin.base.errors import InputError
from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, shared


@click.command(cls=Command)
@click.argument("folder", metavar="A", type=PATH)
@click.argument("paths", metavar="B|AEM|KERNELS...", nargs=-1, required=True, type=PATH)
@click.option("--frame", help="With kernels: the name of the body frame, such as ROS_LANDER.")
@click.option("--base", help="With kernels: the inertial frame. Default: J2000.")
@click.option("--epoch", help="With an AEM or kernels: UTC of time zero, if the results have none.")
@shared()
def compare(folder, paths, frame, base, epoch, output) -> None:
    """Compare results folders A and B of `reproduce`, `rates`, `posterior` or `outcomes`: each change, divided by its error.

    Give an attitude ephemeris message (CCSDS AEM in KVN) instead of B to compare the rates of A with its rates, and the attitudes
    if both have the same frame. Or give SPICE attitude kernels (C-kernel, frames, clock, leap seconds) to compare the rates. For
    two folders, --out writes comparison.csv, comparison.nc and a figure.

    \b
    Examples (the last for those who have ESA's kernels of Philae):
      sunspin compare results what-if --out moved
      sunspin compare rates flight-dynamics.aem
      sunspin compare RESULTS LATT_EME2LDR_SDL_V1_0.BC ROS_V38.TF LANDER_170904_STEP.TSC naif0012.tls --frame ROS_LANDER
    """
    if len(paths) == 1 and paths[0].is_dir():  # a results folder, else kernels
        from sunspin.output.compare import compare as compare_folders

        for name, value in (("--frame", frame), ("--base", base), ("--epoch", epoch)):
            if value is not None:
                what, do = f"{name} belongs to kernels", "leave it out between two folders"
                raise InputError(what, got=str(paths[0]), do=do)
        output.claim()
        output.deliver(compare_folders(folder, paths[0]), main="comparison.csv")
        return
    if missing := next((path for path in paths if not path.exists()), None):
        raise InputError("there is no such file or folder", where=str(missing))
    if output.folder is not None:
        what, do = "--out is for two results folders", "leave it out with other files"
        raise InputError(what, got=str(paths[0]), do=do)
    from sunspin.output.export.against import against_kernels, against_message
    from sunspin.output.export.attitude_message import is_message

    if len(paths) == 1 and frame is None and base is None and is_message(paths[0]):
        summary, line = against_message(folder, paths[0], epoch)
        output.report(summary, [line])
        return
    if frame is None:
        do = "name the body's frame in the kernels, or give a results folder or an AEM in KVN"
        raise InputError("--frame is missing", do=do)
    summary, line = against_kernels(folder, paths, frame, base or "J2000", epoch)
    output.report(summary, [line])
