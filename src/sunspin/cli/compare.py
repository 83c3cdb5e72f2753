"""`sunspin compare`."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.cli.common import claim, deliver, output_options, report


@click.command()
@click.argument("folder", metavar="A", type=click.Path(path_type=Path))
@click.argument("others", metavar="B|KERNELS...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--frame", help="With kernels: the body's frame in them, for example ROS_LANDER.")
@click.option("--base", default="J2000", show_default=True, help="With kernels: an inertial frame of theirs.")
@click.option("--epoch", help="With kernels: UTC of time zero, where the results have none.")
@output_options()
def compare(folder, others, frame, base, epoch, out, as_json, quiet) -> None:
    """What moved between two results folders of `reproduce`, `rates` or `posterior`: row by row, against each row's error.

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
            raise InputError(sentence("--frame belongs to kernels", got=str(others[0]), do="leave it out between two folders"))
        claim(out, "compare")
        deliver(run(folder, others[0]), out, as_json, quiet, None, main="comparison.csv")
        return
    if out is not None:
        raise InputError(sentence("--out is for two results folders", got=str(others[0]), do="leave it out with kernels"))
    _with_kernels(folder, others, frame, base, epoch, as_json, quiet)


def _with_kernels(folder, kernels, frame, base, epoch, as_json, quiet) -> None:
    from datetime import timedelta

    from sunspin.output.export import attitude_of, read_results
    from sunspin.output.export.ck import ephemeris_time, kernel_rates

    if frame is None:
        raise InputError(sentence("--frame is missing", do="name the body's frame in the kernels, or give two results folders"))
    data, _ = read_results(folder)
    attitude = attitude_of(data, None, epoch)
    et = np.array([ephemeris_time(attitude.epoch + timedelta(seconds=float(t))) for t in attitude.t_s])
    theirs = kernel_rates([str(path) for path in kernels], frame, base, et)
    covered = np.isfinite(theirs).all(axis=1)
    if not covered.any():
        raise InputError(sentence("the kernels do not cover any of these times", got=f"{attitude.utc(0)} to {attitude.utc(-1)}"))
    difference = np.degrees(attitude.omega_B[covered] - theirs[covered])
    speed = np.degrees(np.linalg.norm(attitude.omega_B[covered], axis=1) - np.linalg.norm(theirs[covered], axis=1))
    summary = {"samples": len(et), "covered": int(covered.sum()), "rms_deg_s": np.sqrt((difference**2).mean(axis=0)).tolist(),
               "rms_speed_deg_s": float(np.sqrt((speed**2).mean()))}  # fmt: skip
    shown = ", ".join(f"{value:.4g}" for value in summary["rms_deg_s"])
    lines = [f"{summary['covered']} of {len(et)} times covered; rms difference of the rates ({shown}) deg/s in body axes, "
             f"of their size {summary['rms_speed_deg_s']:.4g} deg/s"]  # fmt: skip
    report(summary, lines, as_json, quiet)
