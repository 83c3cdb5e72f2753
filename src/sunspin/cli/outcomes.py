"""`sunspin outcomes`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.cli.changes import Changeable, Opened, once, opened, set_options
from sunspin.cli.common import claim, deliver, on_terminal, output_options, run_options
from sunspin.cli.values import numbers
from sunspin.cli.values import vertical as read_vertical


@click.command(cls=Changeable)
@click.argument("vehicle")
@click.option("--strategy", "strategies", multiple=True, help="What the wheels are told: off (at the touchdown), held, brake, "
              "after_rest (held until the lander rests) or delay:SECONDS (off that much later); may be given several times. "
              "Default: off and held.")
@click.option("--runs", type=click.IntRange(1, 100_000_000), default=100_000, show_default=True, help="Runs per strategy.")
@click.option("--scan", type=click.Path(path_type=Path), help="scan.nc of `sunspin scan`: candidates are its near-minimum set.")
@click.option("--factor", type=click.FloatRange(1, min_open=True), default=1.1, show_default=True, help="Near-minimum factor.")
@click.option("--omega", multiple=True, help="A candidate body rate, rad/s: x,y,z; may be given several times.")
@click.option("--sun", "sun_B", help="Unit vector to the Sun at the candidates' instant, body axes: x,y,z.")
@click.option("--wheel-speed", help="Wheel speeds then, rad/s, separated by commas; default: the vehicle's.")
@click.option("--lead", type=float, help="From touchdown to the candidates' instant, s.")
@click.option("--before", type=float, help="From there to the collision, s.")
@click.option("--after", type=float, help="From the collision to the landing, s.")
@click.option("--collision-speed", type=float, help="Speed at the collision, m/s; 0: no collision.")
@click.option("--landing-speed", type=float, help="Speed at the landing, m/s.")
@click.option("--vertical", help="The ground's normal at the landing, from body axes at the touchdown: legs_down (any for which "
              "legs were lowest there), any, an angle in degrees about legs-down, or x,y,z.")
@click.option("--best-delay", is_flag=True, help="Search for the switch-off delay after which a leg most often touches first.")
@click.option("--condition", is_flag=True, help="Weight the collisions of the first strategy by the trajectory kernel's speeds.")
@click.option("--data", envvar="SUNSPIN_DATA", type=click.Path(path_type=Path), help="Folder with philae_spk/, from which "
              "--condition reads the kernel (or set SUNSPIN_DATA); without it the facts that come with the case are used.")
@click.option("--store", type=click.Path(path_type=Path), help="Folder that keeps what is computed; the same command resumes.")
@click.option("--scheduler", metavar="ADDRESS", help="Run on a Dask cluster: tcp://host:8786 or `local`.")
@click.option("--printed-lines", is_flag=True, help="Take the lines that the paper prints, though this body is another.")
@set_options("study.lead_s", "collision")
@output_options()
@run_options
def outcomes(vehicle, strategies, runs, scan, factor, omega, sun_B, wheel_speed, lead, before, after, collision_speed,
             landing_speed, vertical, best_delay, condition, data,
             store, scheduler, printed_lines, sets, out, as_json, quiet, seed, workers) -> None:  # fmt: skip
    """What a tumbling motion leads to: collision, first contact, antenna, rest, for one or more wheel strategies.

    A built-in case (philae) knows its times, speeds and, as candidates, its published lines. For another vehicle give at
    least --omega (or --scan), --sun and --after; a timeline.toml beside the vehicle file gives the times as well. With --out,
    writes outcomes-STRATEGY.nc, strategies.nc and figures.

    \b
    Examples:
      sunspin outcomes philae --runs 20000 --strategy off --strategy held --out landing
      sunspin outcomes vehicle.toml --omega 0.1,0,0.2 --sun 0,0,1 --after 600 --collision-speed 0 --runs 1000
    """
    from sunspin.landing.scenario import strategy_of
    from sunspin.landing.strategies import best_delay as search
    from sunspin.landing.strategies import compare, compared
    from sunspin.philae.collision_told import against_kernel

    made = opened(vehicle, sets, "study.lead_s", "collision")
    once(made, wheel_speed=("speed_rad_s", wheel_speed), lead=("study.lead_s", lead))
    craft, assumed = made.craft, made.assumptions
    wanted = [strategy_of(craft, name) for name in dict.fromkeys(strategies or ("off", "held"))]
    given = {
        "lead_s": assumed.study.lead_s if lead is None else lead, "before_s": before, "after_s": after,
        "landing_speed_m_s": landing_speed,
        "wheel_speed_rad_s": numbers(wheel_speed, "--wheel-speed") if wheel_speed else None,
        "sun_B": numbers(sun_B, "--sun", 3) if sun_B else None, "vertical": read_vertical(vertical),
        "restitution": assumed.collision.restitution, "damper": assumed.collision.damper,
    }  # fmt: skip
    scenario = _scenario(vehicle, craft, {key: value for key, value in given.items() if value is not None}, collision_speed)
    candidates, whose = _candidates(made, scan, factor, omega, printed_lines)
    claim(out, "outcomes")
    options: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "progress": on_terminal(quiet)}
    table, found = compare(craft, candidates, wanted, runs, seed, scenario, store=store, **options)
    best = search(craft, candidates, n=max(runs // 10, 1), seed=seed, scenario=scenario, **options) if best_delay else None
    weighted = against_kernel(craft.name, next(iter(found.values())), data) if condition else None
    tree = made.mark(compared(table, found, best, weighted))
    deliver(tree, out, as_json, quiet, made.file, also={"candidates_from": whose}, lines=[f"Candidates: {whose}"])


def _scenario(vehicle: str, craft, given: dict[str, Any], collision_speed: float | None):
    """The case's own scenario with what the options say instead, or one made of the options and the timeline beside the vehicle."""
    from sunspin.landing.scenario import Scenario, case_scenario, times_of
    from sunspin.telemetry.case import case_names, load_case, timeline_of

    timeline = timeline_of(vehicle)
    if collision_speed is not None:
        given["collision_speed_m_s"] = collision_speed or None
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is not None and case.timeline is not None:
        return replace(case_scenario(replace(case, vehicle=craft, timeline=timeline or case.timeline)), **given)
    given = dict[str, Any](times_of(timeline)) | given
    for key, option in (("sun_B", "--sun"), ("after_s", "--after")):
        if key not in given:
            raise InputError(sentence(f"{option} is missing", do=f"no times and directions are known of {craft.name!r}"))
    known: dict[str, Any] = {"wheel_speed_rad_s": tuple(wheel.speed_rad_s for wheel in craft.wheels)}
    return Scenario(**known | given)


def _candidates(
    made: Opened, scan: Path | None, factor: float, omega: tuple[str, ...], printed_lines: bool
) -> tuple[np.ndarray, str]:
    """Candidate rates (m, 3) in rad/s, and in words where they come from and whose they are."""
    if (scan is not None) + bool(omega) + printed_lines > 1:
        raise InputError(sentence("candidates come from --scan, from --omega or from --printed-lines", do="give one of them"))
    if omega:
        return np.array([numbers(text, "--omega", 3) for text in omega]), "as given"
    if scan is not None:
        from sunspin.estimate.scan.chosen import stored_near_minimum, stored_vehicle

        of, mine = stored_vehicle(scan), made.craft.said
        other = "" if of == mine else f"; of another body than this run's: {_told(of)}, here {_told(mine)}"
        return stored_near_minimum(scan, factor), f"the near-minimum set of {scan.name}{other}"
    return _printed(made.craft, printed_lines)


def _told(said: dict[str, str]) -> str:
    return ", ".join([said.get("vehicle", "a vehicle without a name"), *said.get("changes", "as in its file").splitlines()])


def _printed(craft: Any, anyway: bool) -> tuple[np.ndarray, str]:
    """The lines that the paper prints, of the case's own body; of another only where they are asked for."""
    from sunspin.philae.rebound import moves_and_sees_alike, published_candidates
    from sunspin.telemetry.case import case_names, load_case

    case = load_case(craft.name) if craft.name in case_names() else None
    if case is None or "line_L1" not in case.published:
        raise InputError(sentence("no candidate motions are given", do="give --omega x,y,z or --scan scan.nc"))
    alike = moves_and_sees_alike(craft, case.vehicle)
    if not alike and not anyway:
        raise InputError(
            sentence(
                "the printed lines were found for another body, wheel or panels than these", got=_told(craft.said),
                do="scan these with the same --set and give --scan scan.nc, give --omega, or keep the lines with --printed-lines",
            )
        )  # fmt: skip
    return published_candidates(case), "the lines that the paper prints" + ("" if alike else ", which are those of another body")
