"""Strings, docstrings, comments and pages use the field's words, in sentences that can be read at once."""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path

from tests.support.documents import ROOT, pages

WORDS = (
    "told|untold|beside|spoilt|mended|anew|nobody|as stated|put in|stands? off|in silence|likewise|whatever|tells|goes on|"
    "is worth|looks? all around|turned copies|speaks? against|stands? aside|heights of the Sun|of before|as they stand|"
    "in the middle|reckoned"
)
"""Words and phrases without a meaning in the field, or with another."""

MOST_WORDS = 30
"""In a sentence, or in a part of it that ends with a semicolon or a colon."""

REBUILT_LATER = {"estimate", "dynamics"}
"""Packages that are written again: their docstrings and comments are read then."""

NO_VERBS = set(
    "a all an as at both by each every for from how if in it its no not of on one so some that the there these this those "
    "to what when where whether which who whose with without".split()
)
"""Words that begin no imperative."""

SENTENCE = re.compile(r"(?<=[.!?*])\s+(?=[A-Z`*\[(])|(?<=[;:])\s")


def strings(tree: ast.AST) -> list[str]:
    """Texts of a module without its docstrings; a field of an f-string is an X."""
    apart, texts = set(), []
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            apart.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            fields = [v.value if isinstance(v, ast.Constant) else "X" for v in node.values]
            texts.append("".join(map(str, fields)))
            apart |= {id(value) for value in node.values}
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    texts += [n.value for n in nodes if isinstance(n.value, str) and id(n) not in apart]
    return [text for text in texts if not text.startswith("KPL/")]


def docstrings(tree: ast.AST) -> list[str]:
    """Return the docstrings of a module, those of its constants and fields included."""
    nodes = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
    constants = (node.value for node in nodes if isinstance(node, ast.Constant))
    return [text for text in constants if isinstance(text, str)]


def comments(source: str) -> list[str]:
    """Return the comments of a module without their number sign."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return [token.string[1:].strip() for token in tokens if token.type == tokenize.COMMENT]


def documented_paths() -> list[Path]:
    """Return the modules whose docstrings and comments are read."""
    package = ROOT / "src" / "sunspin"
    paths = sorted(package.rglob("*.py"))
    return [path for path in paths if path.relative_to(package).parts[0] not in REBUILT_LATER]


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def prose(text: str) -> list[str]:
    """Paragraphs and items of a page, without code and tables."""
    text = re.sub(r"^(`{3,}).*?^\1$|\$\$.*?\$\$|\$.*?\$", "", text, flags=re.MULTILINE | re.DOTALL)
    blocks = re.split(r"\n\s*\n|\n(?=[-|#*:\d])", text)
    return [block for block in blocks if not block.startswith("|")]


def faults(texts: list[str]) -> list[str]:
    found = []
    for text in (text for text in texts if len(text.split()) > 2):
        found += [f"[{m[0]}] {text[:80]}" for m in re.finditer(rf"\b({WORDS})\b", text, re.I)]
        parts = (" ".join(part.split()) for part in SENTENCE.split(text))
        found += [f"[long] {part[:80]}" for part in parts if len(part.split()) > MOST_WORDS]
    return found


def test_printed_strings_use_plain_words_and_short_sentences():
    paths = [path for path in (ROOT / "src").rglob("*.py") if "decoders" not in path.parts]
    assert not [fault for path in paths for fault in faults(strings(tree_of(path)))]


def test_docstrings_and_comments_use_plain_words():
    """Docstrings of functions begin with a verb: articles and question words begin no imperative; the linter's D401 knows more."""
    for path in documented_paths():
        tree = tree_of(path)
        assert not faults(docstrings(tree) + comments(path.read_text("utf-8"))), path
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                first = (ast.get_docstring(node) or "Return").split()[0].lower()
                assert first.strip('.,;:"') not in NO_VERBS, f"{path}:{node.lineno}"


def test_pages_use_plain_words_and_short_sentences():
    assert not [fault for path in pages() for fault in faults(prose(path.read_text("utf-8")))]


def test_the_word_lint_detects_private_words_and_long_sentences():
    assert faults(["nothing is told of it"]) and faults([" ".join(["word"] * 31)])
    assert not faults(["The program prints " + "; ".join(["a few words"] * 20)])
