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
    "rates": "rates vehicle.toml telemetry.csv --out {out}",
    "ambiguous": "rates vehicle.toml telemetry.csv --max-rate-deg-s 30 --to 70 --out {out}",
    "sun": "sun vehicle.toml telemetry.csv --out {out}",
}
"""Picture of the gallery -> the command that makes it, on the files of `sunspin init`."""


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
        for name in missing:
            words = GALLERY[name].format(out=name).split()
            run.invoke(cli, [*words, "--quiet"], catch_exceptions=False)
            picture = "sun" if name == "sun" else "rates"
            shutil.copy(Path(name) / f"{picture}.png", folder / f"{name}.png")


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
