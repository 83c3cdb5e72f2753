"""`sunspin compare`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.base.errors import InputError, sentence
from sunspin.cli.common import claim, deliver, output_options, report


@click.command()
@click.argument("folder", metavar="A", type=click.Path(path_type=Path))
@click.argument(
    "others", metavar="B|KERNELS...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--frame", help="With kernels: the body's frame in them, for example ROS_LANDER.")
@click.option(
    "--base", default="J2000", show_default=True, help="With kernels: an inertial frame of theirs."
)
@click.option("--epoch", help="With kernels: UTC of time zero, where the results have none.")
@output_options()
def compare(folder, others, frame, base, epoch, out, as_json, quiet) -> None:
    """What changed between two results folders of `reproduce`, `rates`, `posterior` or `outcomes`: row by row, against each error.

    With SPICE attitude kernels (C-kernel, frames, clock, leap seconds) in the place of B: the rates of A against theirs. With
    --out, writes comparison.csv, comparison.nc and a figure.

    \b
    Examples (the second for those who have ESA's kernels of Philae):
      sunspin compare results what-if --out moved
      sunspin compare RESULTS LATT_EME2LDR_SDL_V1_0.BC ROS_V38.TF LANDER_170904_STEP.TSC naif0012.tls --frame ROS_LANDER
    """
    if len(others) == 1 and others[0].is_dir():
        from sunspin.output.compare import compare as run

        if frame is not None:
            raise InputError(
                sentence(
                    "--frame belongs to kernels",
                    got=str(others[0]),
                    do="leave it out between two folders",
                )
            )
        claim(out, "compare")
        deliver(run(folder, others[0]), out, as_json, quiet, None, main="comparison.csv")
        return
    if missing := next((other for other in others if not other.exists()), None):
        raise InputError(sentence("there is no such file or folder", where=str(missing)))
    if out is not None:
        raise InputError(
            sentence(
                "--out is for two results folders",
                got=str(others[0]),
                do="leave it out with kernels",
            )
        )
    from sunspin.output.export.against import against_kernels

    if frame is None:
        raise InputError(
            sentence(
                "--frame is missing",
                do="name the body's frame in the kernels, or give two results folders",
            )
        )
    summary, line = against_kernels(folder, others, frame, base, epoch)
    report(summary, [line], as_json, quiet)
