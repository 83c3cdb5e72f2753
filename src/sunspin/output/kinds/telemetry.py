"""Telemetry, directions to the Sun, the quality and the health of panels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sunspin.output.kind import Context, Drawing, Summary, Table, synthetic_note
from sunspin.telemetry.health import NOISE, named_panels
from sunspin.telemetry.sun import is_reconstructed

SETS = 8
"""Sets of panels named on the console, the most frequent ones; `--json` has all."""

HARDLY = 1e-6
"""A probability below this is none to a reader."""


def telemetry_summary(samples: Any) -> Summary:
    """Samples, their time, what is flagged."""
    time = samples["time"].values
    numbers: dict[str, Any] = {
        "samples": int(time.size),
        "span_s": float(np.ptp(time)) if time.size else 0.0,
        "epoch_utc": str(samples.attrs.get("epoch_utc", "")),
        "flagged": int(np.count_nonzero(samples["flag"].values)),
        "synthetic_telemetry": bool(samples.attrs.get("synthetic", 0)),
    }
    kind = "synthetic samples" if numbers["synthetic_telemetry"] else "samples"
    text = f"{numbers['samples']} {kind} over {numbers['span_s']:.0f} s from {numbers['epoch_utc']}"
    return Summary(numbers, [f"{text}; {numbers['flagged']} of them flagged"])


def telemetry_drawings(samples: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.telemetry import signals_figure

    if "panel" in samples.coords:
        yield Drawing(
            "telemetry",
            lambda: signals_figure(samples),
            "Signals of the panels against time.",
            "Signals of the panels as read." + synthetic_note(samples),
        )


def sun_summary(sun: Any) -> Summary:
    """How many samples give a direction, and why the others give none."""
    known = is_reconstructed(sun["status"])
    sigma = sun["sigma_rad"].values[known]
    numbers = {
        "samples": int(known.size),
        "reconstructed": int(known.sum()),
        "status": status_counts(sun),
        "median_sigma_deg": float(np.degrees(np.median(sigma))) if sigma.size else None,
        "noise": float(sun.attrs["noise"]),
        "noise_from": sun.attrs["noise_from"],
        "synthetic_telemetry": bool(sun.attrs.get("synthetic", 0)),
    }
    lines = [
        f"{known.sum()} of {known.size} samples give a direction to the Sun",
        *status_lines(sun),
    ]
    if numbers["median_sigma_deg"] is not None:
        noise = (
            "given"
            if numbers["noise_from"] == "given"
            else f"{numbers['noise']:.3g}, {numbers['noise_from']}"
        )
        lines.append(f"  median uncertainty {numbers['median_sigma_deg']:.2f} deg (noise: {noise})")
    return Summary(numbers, lines)


def status_counts(sun: Any) -> dict[str, int]:
    """Number of samples per status sentence."""
    texts, numbers = np.unique(sun["status_text"].values, return_counts=True)
    return dict(
        sorted(zip(texts.tolist(), numbers.tolist(), strict=True), key=lambda item: -item[1])
    )


def status_lines(sun: Any) -> list[str]:
    return [f"  {number:6d}  {text}" for text, number in status_counts(sun).items()]


def sun_drawings(sun: Any, context: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.telemetry import sun_directions_figure

    if "time" not in sun.coords:
        return
    yield Drawing(
        "sun",
        lambda: sun_directions_figure(sun, context.telemetry),
        "Panel signals, components of the direction to the Sun with error bars, and the misfit Delta of every sample against time.",
        "Panel signals; direction to the Sun in body axes, bars: one sigma; grey marks: samples that give no direction, by reason; "
        "how badly the best direction explains a sample (Delta, no unit)." + synthetic_note(sun),
    )


def sun_tables(sun: Any) -> Iterator[Table]:
    """A row for each sample: direction, misfit, error, and why there is no direction."""
    table = sun[["sun_B", "delta", "sigma_rad", "status_text"]]
    flat = table.drop_vars("sun_B").drop_vars(
        [name for name in ("panel", "axis") if name in table.coords], errors="ignore"
    )
    frame = flat.to_dataframe()
    for k, axis in enumerate("xyz"):
        frame.insert(k, f"sun_{axis}_B", sun["sun_B"].values[:, k])
    frame.index.name = "time_s"
    shown = {"time_s": "time (s)", "delta": "Delta", "sigma_rad": "error (rad)"}
    shown |= {f"sun_{axis}_B": f"Sun {axis}" for axis in "xyz"} | {"status_text": "status"}
    comment = f"time_s from {sun.attrs.get('epoch_utc')}; body axes; sigma_rad is the rms angle of the error"
    yield Table("sun", frame.reset_index(), "Sun direction of each sample", shown, comment)


def quality_summary(quality: Any) -> Summary:
    """What is used of the samples, and the gain of each panel."""
    texts, counts = np.unique(quality["why"].values.astype(str), return_counts=True)
    names = [str(name) for name in quality["panel"].values]
    gain, sigma = quality["gain"].values, quality["gain_sigma"].values
    dead = [name for name, is_dead in zip(names, quality["dead"].values, strict=True) if is_dead]
    numbers = {
        "samples": {str(text): int(count) for text, count in zip(texts, counts, strict=True)},
        "dead": dead,
        "gain": dict(zip(names, gain.tolist(), strict=True)),
        "gain_sigma": dict(zip(names, sigma.tolist(), strict=True)),
    }
    lines = [f"  {count:6d}  {text}" for text, count in numbers["samples"].items()]
    lines += [
        f"  panel {n}: gain {g:.4g} +- {s:.2g}" for n, g, s in zip(names, gain, sigma, strict=True)
    ]
    lines += [f"  panels that never see light: {', '.join(dead)}"] if dead else []
    return Summary(
        numbers, [f"quality of {len(quality['use'])} samples of {len(names)} panels", *lines]
    )


def quality_drawings(quality: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.telemetry import gains_figure

    yield Drawing(
        "panel-quality",
        lambda: gains_figure(quality),
        "Gain of each panel with its error bar.",
        "Gain of each panel in the unit of the vehicle's gains, one sigma; crosses: panels that never see light."
        + synthetic_note(quality),
    )


def health_summary(health: Any) -> Summary:
    """Lit patterns that no Sun makes, whose loss would explain them, and what noise alone may have done."""
    seen = dict(
        zip(_joined(health, "impossible_lit"), health["samples"].values.tolist(), strict=True)
    )
    chance = dict(zip(seen, health["largest"].values.tolist(), strict=True))
    numbers = {
        "allowed": _joined(health, "allowed_lit"),
        "impossible": seen,
        "explanations": [list(lost) for lost in named_panels(health, "lost")],
        "noise_probability": {
            pattern: value for pattern, value in chance.items() if np.isfinite(value)
        },
    }
    lines = health_lines(numbers)
    return Summary(numbers, lines or ["no set of lit panels is one that the Sun cannot light"])


def _joined(health: Any, name: str) -> list[str]:
    return ["-".join(panels) for panels in named_panels(health, name)]


def health_lines(numbers: Mapping[str, Any]) -> list[str]:
    """The numbers of :func:`health_summary` in words; none where no pattern is impossible."""
    if not numbers["impossible"]:
        return []
    often = sorted(numbers["impossible"].items(), key=lambda one: -one[1])
    seen = ", ".join(f"{pattern} ({n})" for pattern, n in often[:SETS])
    seen += f" and {len(often) - SETS} other sets" if len(often) > SETS else ""
    if made_by := numbers.get("made_by"):
        verb = "makes" if made_by == NOISE else "make"
        return [f"  sets of lit panels that the Sun cannot light, as {made_by} {verb} them: {seen}"]
    lost = " or ".join(" and ".join(panels) for panels in numbers["explanations"][:3])
    why = (
        f"the loss or shading of {lost} would explain them"
        if lost
        else "no loss of panels explains them"
    )
    chance = numbers["noise_probability"]
    likely = max(chance.values(), default=0.0)
    noise = (
        f"; noise alone makes the likeliest of them with a probability of at most {likely:.2g}"
        if likely > HARDLY
        else ""
    )
    noise = noise or ("; noise alone does not make them" if chance else "")
    return [f"  sets of lit panels that the Sun cannot light: {seen}; {why}{noise}"]


def health_drawings(health: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.telemetry import health_figure

    yield Drawing(
        "panel-health",
        lambda: health_figure(health),
        "Which panels were lit together although the Sun cannot light them so, and how often.",
        "Sets of panels that were lit together and that the Sun alone cannot light; a panel whose loss explains them is marked."
        + synthetic_note(health),
    )
