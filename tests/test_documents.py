"""The documents are true: every code block runs, or states why it does not."""

import ast
import re
import runpy

import click
import pytest

from tests.support.documents import LANGUAGES, ROOT, WRITTEN, Block, Reader, blocks, pages

PAGES = {str(path.relative_to(ROOT)): path for path in pages()}
BLOCKS = {name: blocks(path.read_text("utf-8")) for name, path in PAGES.items()}
RUNS = ("python", "console")
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))


LAYERS = ("", "long", "slow")


def runnable(name: str, mark: str) -> list[Block]:
    """Blocks of a page with this mark, and those that cost less, which they may build on."""
    layers = LAYERS[: LAYERS.index(mark) + 1]
    return [block for block in BLOCKS[name] if not block.skipped and block.mark in layers]


def cases() -> list:
    found = []
    for name in PAGES:
        run = [block for block in BLOCKS[name] if block.language in RUNS and not block.skipped]
        for mark in LAYERS:
            if any(block.mark == mark for block in run):
                marks = [getattr(pytest.mark, mark)] if mark else []
                found.append(
                    pytest.param(name, mark, id=f"{name}-{mark}" if mark else name, marks=marks)
                )
    return found


@pytest.mark.parametrize(("name", "mark"), cases())
def test_code_blocks_of_a_page_run_and_print_what_it_shows(
    name, mark, tmp_path, monkeypatch, framed
):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    reader = Reader(PAGES[name], tmp_path)
    for block in runnable(name, mark):
        reader.follow(block)


@pytest.mark.parametrize("name", PAGES)
def test_every_code_block_names_its_language(name):
    """A block without a language would not be run and nobody would see it; indented commands neither."""
    for block in BLOCKS[name]:
        assert block.language in LANGUAGES, f"{name}, line {block.line}"
    page, fences = PAGES[name].read_text("utf-8"), r"^(`{3,}|:{3,}).*?^\1$"
    text = re.sub(fences, "", page, flags=re.MULTILINE | re.DOTALL)
    bare = re.search(r"^ {4,}(\$|sunspin|make|python|pip) ", text, re.MULTILINE)
    assert not bare, f"{name} has commands outside a console block"


def test_the_runner_of_code_blocks_detects_wrong_output_and_failures(tmp_path):
    """Negative controls: wrong output, a command that fails, a block that raises."""
    page = PAGES["README.md"]
    for text in (
        "```python\nprint(1)\n```\n\n```text\n2\n```\n",
        "```console\n$ sunspin no-such-command\n```\n",
        "```console\n$ echo one\ntwo\n```\n",
        "```python\n1 / 0\n```\n",
    ):
        (block,) = blocks(text)
        with pytest.raises((AssertionError, ZeroDivisionError, click.ClickException, SystemExit)):
            Reader(page, tmp_path).follow(block)
    text = "<!-- not run: it needs a cluster of machines -->\n\n```console\n$ false\n```\n"
    (block,) = blocks(text)
    assert block.skipped


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path, monkeypatch, capsys):
    """Each ends with assertions of what it has shown; here they only must not fail."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()


def test_examples_are_numbered_without_gap():
    assert [int(path.stem[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))


def test_links_of_the_pages_lead_to_existing_files():
    for name, path in PAGES.items():
        for link in re.findall(r"\]\((?!https?:|#)([^)#]+)", path.read_text("utf-8")):
            is_there = link.split("/")[-1] in WRITTEN or (path.parent / link).exists()
            assert is_there, f"{name}: {link}"


def test_each_convention_is_numbered_and_names_a_test_that_exists():
    """Items of docs/conventions.md name the tests that pin them, as tests/file.py::name."""
    text = (ROOT / "docs" / "conventions.md").read_text("utf-8")
    items = re.split(r"^(?=\d+\. )", text, flags=re.MULTILINE)[1:]
    assert [int(item.split(".")[0]) for item in items] == list(range(1, len(items) + 1))
    for item in items:
        named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", item)
        assert named, item
        for path, name in named:
            body = ast.parse((ROOT / path).read_text("utf-8")).body
            assert name in {getattr(node, "name", "") for node in body}, f"{path}::{name}"


def test_the_reference_lists_every_public_name():
    import sunspin

    text = (ROOT / "docs" / "api.md").read_text("utf-8")
    listed = re.findall(r"^\.\. auto\w+:: sunspin\.(\w+)$", text, re.MULTILINE)
    assert sorted(listed) == sorted(set(sunspin.__all__) - {"__version__"})
