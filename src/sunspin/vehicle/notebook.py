"""Display of a vehicle and a case in a notebook, as short HTML tables. All text is escaped, as names come from files."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from sunspin.cases import Case
    from sunspin.vehicle import Vehicle


def vehicle_html(vehicle: Vehicle) -> str:
    """Return a vehicle as HTML: mass and inertia, and a row for each panel, wheel and leg."""
    unit = vehicle.gain_unit or "relative"
    inertia = "not given" if vehicle.inertia_kg_m2 is None else _vectors(vehicle.inertia_kg_m2)
    facts = [
        ("mass, kg", "not given" if vehicle.mass_kg is None else f"{vehicle.mass_kg:g}"),
        ("inertia, kg m²", inertia),
    ]
    parts = [f"<b>Vehicle {escape(vehicle.name)}</b>", _table(facts)]
    if vehicle.panels:
        rows = [
            (panel.name, _vector(panel.normal_B), f"{panel.gain:g}") for panel in vehicle.panels
        ]
        parts.append(_table(rows, ("panel", "normal (body)", f"gain, {unit}")))
    if vehicle.wheels:
        rows = [
            (w.name, _vector(w.axis_B), f"{w.inertia_kg_m2:g}", f"{w.speed_rad_s:g}")
            for w in vehicle.wheels
        ]
        parts.append(_table(rows, ("wheel", "axis (body)", "inertia, kg m²", "speed, rad/s")))
    if vehicle.legs:
        parts.append(
            _table(
                [(leg.name, _vector(leg.tip_B_m)) for leg in vehicle.legs], ("leg", "tip (body), m")
            )
        )
    return "<div>" + "".join(parts) + "</div>"


def case_html(case: Case) -> str:
    """Return a case as HTML: events, number of published values, and vehicle. The telemetry is not read."""
    parts = [f"<b>Case {escape(case.name)}</b>"]
    if case.timeline is not None:
        rows = [
            (event.name.replace("_", " "), event.refined_utc or event.utc, event.source)
            for event in case.timeline.events
        ]
        parts.append(_table(rows, ("event", "UTC", "source")))
    parts.append(f"<p>{len(case.published)} published figures</p>")
    return "<div>" + "".join(parts) + vehicle_html(case.vehicle) + "</div>"


def _table(rows: Iterable[Iterable[str]], head: Iterable[str] = ()) -> str:
    """Return an HTML table of text cells."""
    top = "".join(f'<th style="text-align:left">{escape(name)}</th>' for name in head)
    body = "".join(
        "<tr>"
        + "".join(f'<td style="text-align:left">{escape(cell)}</td>' for cell in row)
        + "</tr>"
        for row in rows
    )
    return f"<table>{f'<thead><tr>{top}</tr></thead>' if top else ''}<tbody>{body}</tbody></table>"


def _vector(values: np.ndarray) -> str:
    """Return a vector as text with four digits."""
    return ", ".join(f"{value:.4g}" for value in values)


def _vectors(rows: np.ndarray) -> str:
    """Return the rows of a matrix as text."""
    return "; ".join(_vector(row) for row in rows)
