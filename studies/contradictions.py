"""Statements of the paper that contradict its own figures or public facts, each recomputed and read as fairly as possible.

Run `python -m studies.contradictions OUT`.

`contradictions.toml` in this folder has a table for each statement: the paper's sentence, the fairest other reading, the
consequence. Its `ours`, `published` and the fields in its texts are names of `facts` in that file, of numbers of
`paper_numbers.py`, or of figures in `published.toml`. Statements marked `weak` are matters of wording, harmless, or nearly
explained by the other reading. OUT receives table, picture and `contradictions.json`, which the package ships in cases/philae/ for
the page of `sunspin reproduce`.
"""

from __future__ import annotations

import json
import sys
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from studies.paper_numbers import Lines, descent_numbers, motion_numbers, simulate_lines
from sunspin.cases import Case, load_case
from sunspin.output.figures import COLOURS
from sunspin.output.text import number_text
from validation.campaign import command, rows_folder, study_parser

COMMAND = "python -m studies.contradictions OUT"
TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))


def evaluate_statements(case: Case, lines: Lines) -> list[dict[str, Any]]:
    """Return each statement with its texts filled and its verdict `holds`.

    `holds` is true if both numbers differ by no more than the tolerance, and None for a statement without one.
    """
    tables = {**TEXTS}
    # published figures, facts and numbers of this study, by the names that the file uses
    paper = {key: figure.value for key, figure in case.published.items()} | tables.pop("facts")
    numbers = descent_numbers(case, paper) | motion_numbers(case, paper, lines)
    known, fields = paper | numbers, numbers | {"paper": paper}
    statements = []
    for name, table in tables.items():
        published, ours = look_up(table["published"], known), look_up(table["ours"], known)
        row = {"id": name, "published": published, "ours": ours, "holds": None}
        if (tolerance := look_up(table.get("tolerance"), known)) is not None:
            row["holds"] = bool(np.all(np.abs(np.subtract(ours, published)) <= tolerance))
        row["weak"] = table.get("weak", False)
        texts = [key for key in table if key not in {*row, "tolerance"}]
        statements.append(row | {key: table[key].format_map(fields) for key in texts})
    return statements


def look_up(name: Any, known: dict[str, Any]) -> Any:
    """Return the value with this name, or the values of a list of names; a name that is not known is itself the value."""
    if isinstance(name, list):
        return [look_up(item, known) for item in name]
    value = known.get(name, name) if isinstance(name, str) else name
    return value if isinstance(value, str) else np.asarray(value).tolist()


def make_table(statements: list[dict[str, Any]]) -> str:
    """Return the statements in Markdown, weak ones last."""
    text = "| statement | the paper | recomputed | what it changes |\n|---|---|---|---|\n"
    for row in sorted(statements, key=lambda row: row["weak"]):
        statement = f"{row['what']} ({row['place']}){'; weak' if row['weak'] else ''}"
        unit = "" if row["unit"] in ("1", "section") else f" {row['unit']}"
        published, ours = (
            value if isinstance(value, str) else number_text(value) + unit
            for value in (row["published"], row["ours"])
        )
        text += f"| {statement} | {published} | {ours} | {row['changes']} |\n"
    return text


def contradictions_figure(case: Case, lines: Lines) -> Figure:
    """Draw the descent's rate, the motion of the z axis and the speed at the collision, each with the paper's statement."""
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    descent, nutation, speed = figure.subplots(1, 3)
    paper = {key: figure.value for key, figure in case.published.items()}
    t = np.linspace(0.0, 3600.0 * paper["descent_span"], 500)
    rate = np.polynomial.polynomial.polyval(t, paper["descent_rate_cubic"])
    descent.plot(t / 3600, 1e3 * rate, color=COLOURS[0], label="printed coefficients")
    ends = 1e3 * np.array(paper["descent_rate_range"])
    descent.axhspan(*ends, color=COLOURS[1], alpha=0.3, label="printed range")
    descent.set(xlabel="time from the start of the fit (h)", ylabel="rate about z (mrad/s)")
    # the z axis moves by twice its angle to the angular momentum
    for k, angle in enumerate(2 * lines.nutation_deg):
        nutation.plot(
            lines.omega_z, angle, "-" if k < 2 else "--", color=COLOURS[k], label=f"L{k + 1}"
        )
    height = np.diff(paper["sun_height_range"])[0]
    nutation.axhline(height, ls=":", color=COLOURS[7], label="the paper: range of the Sun's height")
    nutation.set(xlabel="omega_z at the first sample (rad/s)", ylabel="swing of the z axis (deg)")
    for k, (rule, values) in enumerate(lines.at_collision.items()):
        share = np.arange(1, values.size + 1) / values.size
        speed.step(
            np.sort(values), share, ("-", "--")[k], where="post", color=COLOURS[k], label=rule
        )
    speed.axvline(paper["rate_at_collision"], ls=":", color=COLOURS[7], label="the paper")
    speed.set(xlabel="angular speed at the collision (rad/s)", ylabel="share of motions below")
    speed.set_ylim(0.0, 1.3)
    for axes in (descent, nutation, speed):
        axes.legend(fontsize=8)
    return figure


@command
def main(arguments: list[str] | None = None) -> None:
    """Evaluate the statements and write them as JSON, table and figure."""
    parser = study_parser("contradictions", __doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    out, case = rows_folder(parser.parse_args(arguments).out), load_case("philae")
    lines = simulate_lines(case)
    statements = evaluate_statements(case, lines)
    content = {
        "made": datetime.now(UTC).strftime("%Y-%m-%d"),
        "command": COMMAND,
        "statements": statements,
    }
    (out / "contradictions.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (out / "contradictions.md").write_text(make_table(statements), "utf-8")
    contradictions_figure(case, lines).savefig(out / "contradictions.png", dpi=150)
    print(make_table(statements))


if __name__ == "__main__":
    sys.exit(main())
