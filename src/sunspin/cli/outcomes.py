"""`sunspin outcomes`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.cli.common import claim, deliver, numbers, on_terminal, output_options, run_options


@click.command()
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
@output_options()
@run_options
def outcomes(vehicle, strategies, runs, scan, factor, omega, sun_B, wheel_speed, lead, before, after, collision_speed,
             landing_speed, vertical, best_delay, condition, data,
             store, scheduler, out, as_json, quiet, seed, workers) -> None:  # fmt: skip
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
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    wanted = [strategy_of(craft, name) for name in dict.fromkeys(strategies or ("off", "held"))]
    given = {
        "lead_s": lead, "before_s": before, "after_s": after, "landing_speed_m_s": landing_speed,
        "wheel_speed_rad_s": numbers(wheel_speed, "--wheel-speed") if wheel_speed else None,
        "sun_B": numbers(sun_B, "--sun", 3) if sun_B else None, "vertical": _vertical(vertical),
    }  # fmt: skip
    scenario = _scenario(vehicle, craft, {key: value for key, value in given.items() if value is not None}, collision_speed)
    candidates = _candidates(craft, scan, factor, omega)
    claim(out, "outcomes")
    options = {"workers": workers, "scheduler": scheduler, "progress": on_terminal(quiet)}
    table, found = compare(craft, candidates, wanted, runs, seed, scenario, store=store, **options)
    parts = []
    if best_delay:
        parts.append(_best(search(craft, candidates, n=max(runs // 10, 1), seed=seed, scenario=scenario, **options)))
    if condition:
        parts.append(_weighted(_condition(craft, next(iter(found.values())), data)))
    also = {key: value for numbers, _, _ in parts for key, value in numbers.items()}
    lines, drawings = [line for _, told, _ in parts for line in told], [drawing for _, _, drawing in parts]
    deliver(compared(table, found), out, as_json, quiet, vehicle, also=also, lines=lines, drawings=drawings)


def _best(best) -> tuple[dict[str, Any], list[str], Any]:
    """The search for the delay in numbers, in words and as a figure."""
    from sunspin.output.kinds.outcomes import delay_drawing

    numbers = {"best_delay": {"delay_s": best.best_s, "as_good_s": best.as_good_s, "spread_s": best.spread_s}}
    line = (
        f"a leg touches first most often if the wheel is switched off {best.best_s:g} s after the touchdown "
        f"({best.value.max():.3f}); not worse by two errors: {', '.join(f'{t:g}' for t in best.as_good_s)} s"
    )
    return numbers, [line], delay_drawing(best)


def _vertical(text: str | None) -> Any:
    if text is None or text in ("legs_down", "any"):
        return text
    values = numbers(text, "--vertical")
    if len(values) == 1:
        return float(np.radians(values[0]))
    if len(values) == 3:
        return tuple(values)
    raise InputError(sentence("--vertical takes legs_down, any, an angle in degrees or x,y,z", got=text))


def _scenario(vehicle: str, craft, given: dict[str, Any], collision_speed: float | None):
    """The case's own scenario with what the options say instead, or one made of the options and the timeline beside the vehicle."""
    from sunspin.landing.scenario import Scenario, case_scenario, times_of
    from sunspin.telemetry.case import case_names, load_case, timeline_of

    timeline = timeline_of(vehicle)
    if collision_speed is not None:
        given["collision_speed_m_s"] = collision_speed or None
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is not None and case.timeline is not None:
        return replace(case_scenario(replace(case, timeline=timeline or case.timeline)), **given)
    given = times_of(timeline) | given
    for key, option in (("sun_B", "--sun"), ("after_s", "--after")):
        if key not in given:
            raise InputError(sentence(f"{option} is missing", do=f"no times and directions are known of {craft.name!r}"))
    known: dict[str, Any] = {"wheel_speed_rad_s": tuple(wheel.speed_rad_s for wheel in craft.wheels)}
    return Scenario(**known | given)


def _candidates(craft, scan: Path | None, factor: float, omega: tuple[str, ...]) -> np.ndarray:
    if scan is not None and omega:
        raise InputError(sentence("candidates come from --scan or from --omega", do="give one of them"))
    if omega:
        return np.array([numbers(text, "--omega", 3) for text in omega])
    if scan is not None:
        return _near_minimum(scan, factor)
    from sunspin.philae.rebound import published_candidates
    from sunspin.telemetry.case import case_names, load_case

    if craft.name in case_names() and "line_L1" in load_case(craft.name).published:
        return published_candidates(load_case(craft.name))
    raise InputError(sentence("no candidate motions are given", do="give --omega x,y,z or --scan scan.nc"))


def _near_minimum(path: Path, factor: float) -> np.ndarray:
    from sunspin.base.netcdf import read_netcdf
    from sunspin.estimate.scan.volume import near_minimum

    if not path.is_file():
        raise InputError(sentence("there is no such file", do="give scan.nc as `sunspin scan --out` writes it", where=str(path)))
    file = read_netcdf(path, str(path), InputError)
    volume = file.get("emd", file.get("E"))
    if volume is None or set(volume.dims) != {"omega_x", "omega_y", "omega_z"} or not set(volume.dims) <= set(volume.coords):
        raise InputError(sentence("this is no scan", do="give scan.nc as `sunspin scan` writes it", where=str(path)))
    if not all(np.issubdtype(part.dtype, np.number) for part in (volume, *volume.coords.values())):
        raise InputError(sentence("this scan holds what is no number", do="write it again", where=str(path)))
    return near_minimum(volume, factor)


def _condition(craft, runs, data: Path | None):
    """The collisions weighted by the kernel in the data folder, or by the facts that come with the case."""
    from sunspin.philae import collision
    from sunspin.telemetry.case import case_names, load_case

    case = load_case(craft.name) if craft.name in case_names() else None
    if case is None or "kernel_speed_before" not in case.published or not np.isfinite(runs["speed_after"]).any():
        raise InputError(sentence("--condition needs collisions of a case with a trajectory kernel", do="use it with philae"))
    there = data if data is not None and data.joinpath(*collision.KERNEL).is_file() else None
    return collision.condition(case, runs, None if there is None else collision.kernel_facts(case, there))


def _weighted(found) -> tuple[dict[str, Any], list[str], Any]:
    """The conditioned collisions in numbers, in words and as a figure."""
    from sunspin.output.kinds.kind import Drawing
    from sunspin.philae.figures.collision import collision_figure

    head = f"collision: {found.explained} of the runs come near the kernel's jump and speed"
    lines = [
        f"  {line['name']}: worth {line['effective_runs']:.0f} runs, rate before {line['rate_before']}, after {line['rate_after']} "
        f"rad/s, median period after {line['median_period_after']:.1f} s"
        for line in found.table
    ]
    drawing = Drawing(
        "collision", lambda: collision_figure(found), "Simulated collisions against the speeds of the trajectory kernel.",
        "Simulated collisions and what the trajectory shows; angular speeds after it as drawn and weighted by the kernel's speeds.",
    )  # fmt: skip
    return {"collision": {"facts": found.facts, "explained": found.explained, "table": found.table}}, [head, *lines], drawing
