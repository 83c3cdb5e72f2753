"""What the site adds to Sphinx: equations as MathML, and pages that are written by the program and not by hand."""

from __future__ import annotations

from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

HERE = Path(__file__).parent
ROOT = HERE.parent


def inline_math(translator, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def block_math(translator, node: nodes.math_block) -> None:
    """Write an equation, its number at the right and a link to it."""
    target = f' id="{node["ids"][0]}"' if node.get("ids") else ""
    translator.body.append(f'<div class="math"{target}>')
    if node.get("number"):
        link = (
            f'<a class="headerlink" href="#{node["ids"][0]}" title="Link to this equation">¶</a>'
            if target
            else ""
        )
        translator.body.append(f'<span class="eqno">({node["number"]}){link}</span>')
    translator.body.append(tex2mathml(node.astext(), as_block=True) + "</div>\n")
    raise nodes.SkipNode


def commands() -> str:
    """Return the page on the command line, from each command's --help."""
    import click

    from sunspin.cli import cli
    from sunspin.cli.common import COMMANDS

    parts = ["# Command line", "", "The text that `--help` prints for each command.", ""]
    top = click.Context(cli, info_name="sunspin", max_content_width=100)
    for name, (_, line) in COMMANDS.items():
        command = cli.get_command(top, name)
        assert command is not None
        text = command.get_help(
            click.Context(
                command, info_name=name, parent=top, max_content_width=100, terminal_width=100
            )
        )
        parts += [f"## {name}", "", line, "", "```text", text, "```", ""]
    return "\n".join(parts)


def examples() -> str:
    """Return the page of the numbered programs of examples/, each under the first line of its docstring."""
    import ast

    parts = [
        "# Examples",
        "",
        "Short programs, run as `python examples/01_sun_from_powers.py`. The tests run all of them.",
        "",
    ]
    for path in sorted((ROOT / "examples").glob("[0-9]*.py")):
        title = (
            (ast.get_docstring(ast.parse(path.read_text("utf-8"))) or path.stem)
            .splitlines()[0]
            .rstrip(".")
        )
        parts += [f"## {path.stem[:2]}. {title}", "", f"`examples/{path.name}`", ""]
        parts += [f"```{{literalinclude}} ../examples/{path.name}", ":language: python", "```", ""]
    return "\n".join(parts)


def variables() -> str:
    """Return the page of the NetCDF variables with their units."""
    import csv

    path = ROOT / "src" / "sunspin" / "base" / "variables.csv"
    rows = ["| variable | unit | meaning |", "|---|---|---|"]
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            rows.append(f"| `{row['name']}` | {row['units']} | {row['long_name']} |")
    return "\n".join(rows) + "\n"


GALLERY = {
    "rates": ("rates vehicle.toml telemetry.csv --out rates",),
    "ambiguous": ("rates vehicle.toml telemetry.csv --max-rate-deg-s 30 --to 70 --out ambiguous",),
    "sun": ("sun vehicle.toml telemetry.csv --out sun",),
    "pointing": (
        "rates vehicle.toml telemetry.csv --out rates",
        "pointing rates --axis +z --axis -x --step 5 --out pointing",
    ),
    "history": (
        "rates vehicle.toml week.csv --max-rate-deg-s 3 --out week",
        "history week --out history",
    ),
    "plan": (
        "plan vehicle.toml --every 10,60 --samples 12 --max-rate-deg-s 3 --passes 6 --out plan",
    ),
}
"""Picture of the gallery -> the commands that make it, on the files of `sunspin init` and :func:`write_week`; the last one has the
folder of that name."""

PICTURES = {"ambiguous": "rates"}
"""Picture of the gallery -> file of its folder, if that has another name."""

PASSES, DAY_S = 10, 86_400.0
"""Passes of the week in the gallery."""


def write_week(place: Path) -> None:
    """Write a week of synthetic telemetry of the example satellite, whose spin slows down, to week.csv."""
    import numpy as np

    import sunspin as ss
    from sunspin.telemetry.synthetic import csv_text

    vehicle, rng = ss.load_vehicle(place / "vehicle.toml"), np.random.default_rng(0)
    lines: list[str] = []
    for k in range(PASSES):
        t_s = 0.7 * DAY_S * k + 15.0 * np.arange(30)
        speed = np.radians(1.4 - 0.09 * k + 0.02 * rng.normal())
        axis = np.array([0.3, 0.2, 1.0]) + 0.05 * rng.normal(size=3)
        sun = rng.normal(size=3)
        truth = {
            "omega_B": speed * axis / np.linalg.norm(axis),
            "sun_B": sun / np.linalg.norm(sun),
            "t_s": t_s,
            "wheel_mode": "hold",
        }
        header, *rows = csv_text(vehicle, ss.twin(vehicle, truth, seed=k), []).splitlines()
        lines += rows if lines else [header, *rows]
    (place / "week.csv").write_text("\n".join(["# Synthetic week", *lines]) + "\n", "utf-8")


def draw_gallery(folder: Path) -> None:
    """Run the cheap cases of the gallery and keep their pictures; those that are there are not drawn again."""
    import contextlib
    import shutil
    import tempfile

    from click.testing import CliRunner

    from sunspin.cli import cli

    missing = [name for name in GALLERY if not (folder / f"{name}.png").exists()]
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        run = CliRunner()
        run.invoke(cli, ["init", "."], catch_exceptions=False)
        write_week(Path())
        commands = dict.fromkeys(command for name in missing for command in GALLERY[name])
        for command in commands:
            run.invoke(cli, [*command.split(), "--quiet"], catch_exceptions=False)
        for name in missing:
            shutil.copy(Path(name) / f"{PICTURES.get(name, name)}.png", folder / f"{name}.png")


def write_pages(app) -> None:
    """Write the generated pages; one that did not change is left as it is, so that a second build is short."""
    from evidence_page import page

    written = {
        "cli.md": commands(),
        "examples.md": examples(),
        "variables.md": variables(),
        "believe.md": page(app.config.evidence_file or None),
    }
    for name, text in written.items():
        target = HERE / name
        if not target.exists() or target.read_text("utf-8") != text:
            target.write_text(text, "utf-8")
    draw_gallery(HERE / "gallery")


def setup(app) -> dict:
    app.add_html_math_renderer(
        "mathml", inline_renderers=(inline_math, None), block_renderers=(block_math, None)
    )
    app.add_config_value("evidence_file", "", "env")
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
