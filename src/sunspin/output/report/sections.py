"""The page as a list of sections: each builder looks in the results for what it knows, and a failure in one leaves the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from sunspin.output.report import (
    headline,
    lander,
    landing,
    measured,
    orbit,
    other,
    overview,
    posterior,
    quality,
    rate_space,
    rows,
    runs,
    sphere,
)
from sunspin.output.report.read import Results
from sunspin.output.report.section import Drawn, Plot, Section


@dataclass
class Page:
    """All that the template shows."""

    title: str
    synthetic: bool
    headline: list[str]
    hero: Plot | Drawn | None
    facts: list[tuple[str, str, str]]
    sections: list[Section] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    first_line: str = ""
    why_nothing: str = ""
    score: list[str] = field(default_factory=list)
    changes: list[str] = field(default_factory=list)
    language: str = "en"


BUILDERS: tuple[tuple[str, Callable[[Results], Section | None]], ...] = (
    ("timeline", overview.timeline),
    ("the lander in motion", lander.section),
    ("rates", runs.rates),
    ("the trajectory", runs.trajectory),
    ("the posterior", posterior.section),
    ("powers", measured.powers),
    ("the Sun's path", sphere.sun_path),
    ("rate space", rate_space.lines),
    ("maps", rate_space.maps),
    ("outcomes", landing.outcomes),
    ("strategies", landing.strategies),
    ("the comparison", rows.section),
    ("contradictions", rows.contradictions),
    ("the orbit", orbit.section),
    ("data quality", quality.section),
    ("conclusions", other.conclusions),
    ("other results", other.unknown),
    ("provenance", other.provenance),
)
"""What is tried, in the page's order."""


LABELS = ["What happened", "How sure", "What it rests on"]
"""Over the three sentences of a study."""


def page(results: Results) -> Page:
    """The page of a results folder."""
    hero = guarded(results, "the first picture", overview.hero)
    sections = [
        part for name, build in BUILDERS if (part := guarded(results, name, build)) is not None
    ]
    told = guarded(results, "the summary", headline.sentences) or []
    return Page(
        title=headline.title(results),
        synthetic=results.synthetic,
        headline=told,
        labels=LABELS if "headline" in results.summary and len(told) == len(LABELS) else [],
        hero=hero,
        facts=guarded(results, "key figures", headline.facts) or [],
        first_line=headline.first_line(results),
        why_nothing=results.why_nothing,
        score=headline.score(results),
        changes=headline.changes(results),
        sections=sections,
    )


def guarded(results: Results, name: str, build: Callable[[Results], Any]) -> Any:
    """What the builder makes, or None and a sentence in `problems`."""
    try:
        return build(results)
    # data of any origin and age: a page without one part is worth more than no page
    except Exception as error:
        results.problems.append(
            f"A part of this page could not be made: {name} ({type(error).__name__}: {error})."
        )
        return None
