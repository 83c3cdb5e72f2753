"""Statements of the paper that contradict its own figures or public facts, each recomputed and read as fairly as possible.

    python -m studies.contradictions OUT

`contradictions.toml` beside this script has a table for each statement: the paper's sentence, the fairest other reading, what
follows. Its `ours`, its `published` and fields in its texts name its `facts`, numbers of `paper_numbers.py` or `published.toml`.
Statements marked `weak` are matters of wording, harmless, or nearly explained by the other reading. OUT holds table, picture and
`contradictions.json`, which the package ships in cases/philae/ for the page of `sunspin reproduce`.
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

from studies.paper_numbers import Lines, motions_on_lines, of_descent, of_motion
from sunspin.cases import Case, load_case
from sunspin.output.figures import COLOURS
from sunspin.output.text import number_text
from validation.campaign import command, rows_folder, study_parser

COMMAND = "python -m studies.contradictions OUT"
TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))


def statements(case: Case, lines: Lines) -> list[dict[str, Any]]:
    """Each statement with its texts filled; `holds` where both numbers differ by no more than the tolerance, None without one."""
    tables = {**TEXTS}
    paper = {key: figure.value for key, figure in case.published.items()} | tables.pop("facts")
    numbers = of_descent(case, paper) | of_motion(case, paper, lines)

    def value(name: Any) -> Any:
        if isinstance(name, list):
            return [value(each) for each in name]
        number = (paper | numbers).get(name, name) if isinstance(name, str) else name
        return number if isinstance(number, str) else np.asarray(number).tolist()

    each = []
    for name, table in tables.items():
        published, ours = value(table["published"]), value(table["ours"])
        row = {"id": name, "published": published, "ours": ours, "holds": None}
        if (tolerance := value(table.get("tolerance"))) is not None:
            row["holds"] = bool(np.all(np.abs(np.subtract(ours, published)) <= tolerance))
        row["weak"], fields = table.get("weak", False), numbers | {"paper": paper}
        texts = [key for key in table if key not in {*row, "tolerance"}]
        each.append(row | {key: table[key].format_map(fields) for key in texts})
    return each


def table_of(each: list[dict[str, Any]]) -> str:
    """The statements in Markdown, those that are not weak first."""
    text = "| statement | the paper | recomputed | what it changes |\n|---|---|---|---|\n"
    for row in sorted(each, key=lambda row: row["weak"]):
        what = f"{row['what']} ({row['place']}){'; weak' if row['weak'] else ''}"
        unit = "" if row["unit"] in ("1", "section") else f" {row['unit']}"
        values = (row["published"], row["ours"])
        cells = [what, *(v if isinstance(v, str) else number_text(v) + unit for v in values)]
        text += "| " + " | ".join([*cells, row["changes"]]) + " |\n"
    return text


def draw(case: Case, lines: Lines) -> Figure:
    """The descent's rate, the swing of the z axis and the speed at the collision, each beside what the paper says of it."""
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    descent, swing, speed = figure.subplots(1, 3)
    paper = {key: figure.value for key, figure in case.published.items()}
    t = np.linspace(0.0, 3600.0 * paper["descent_span"], 500)
    rate = np.polynomial.polynomial.polyval(t, paper["descent_rate_cubic"])
    descent.plot(t / 3600, 1e3 * rate, color=COLOURS[0], label="printed coefficients")
    ends = 1e3 * np.array(paper["descent_rate_range"])
    descent.axhspan(*ends, color=COLOURS[1], alpha=0.3, label="printed range")
    descent.set(xlabel="time from the start of the fit (h)", ylabel="rate about z (mrad/s)")
    for k, angle in enumerate(2 * lines.nutation_deg):
        swing.plot(
            lines.omega_z, angle, "-" if k < 2 else "--", color=COLOURS[k], label=f"L{k + 1}"
        )
    height = np.diff(paper["sun_height_range"])[0]
    swing.axhline(height, ls=":", color=COLOURS[7], label="the paper: range of the Sun's height")
    swing.set(xlabel="omega_z at the first sample (rad/s)", ylabel="swing of the z axis (deg)")
    for k, (rule, values) in enumerate(lines.at_collision.items()):
        share = np.arange(1, values.size + 1) / values.size
        speed.step(
            np.sort(values), share, ("-", "--")[k], where="post", color=COLOURS[k], label=rule
        )
    speed.axvline(paper["rate_at_collision"], ls=":", color=COLOURS[7], label="the paper")
    speed.set(xlabel="angular speed at the collision (rad/s)", ylabel="share of motions below")
    speed.set_ylim(0.0, 1.3)
    for axes in (descent, swing, speed):
        axes.legend(fontsize=8)
    return figure


@command
def main(arguments: list[str] | None = None) -> None:
    parser = study_parser("contradictions", __doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    out, case = rows_folder(parser.parse_args(arguments).out), load_case("philae")
    lines = motions_on_lines(case)
    each = statements(case, lines)
    made = {"made": datetime.now(UTC).strftime("%Y-%m-%d"), "command": COMMAND, "statements": each}
    (out / "contradictions.json").write_text(json.dumps(made, indent=1) + "\n", "utf-8")
    (out / "contradictions.md").write_text(table_of(each), "utf-8")
    draw(case, lines).savefig(out / "contradictions.png", dpi=150)
    print(table_of(each))


if __name__ == "__main__":
    sys.exit(main())
