"""Printed strings, help and pages use the field's words, in sentences that can be read at once."""

import ast
import re

from tests.support.documents import ROOT, pages

WORDS = (
    "told|untold|beside|spoilt|mended|anew|nobody|as stated|put in|stands? off|in silence|likewise|whatever|tells|goes on|"
    "is worth|looks? all around|turned copies|speaks? against|stands? aside|heights of the Sun|of before|as they stand|"
    "in the middle|reckoned"
)
"""Words and phrases without a meaning in the field, or with another."""

MOST_WORDS = 30
"""In a sentence, or in a part of it that ends with a semicolon or a colon."""

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
    assert not [fault for path in paths for fault in faults(strings(ast.parse(path.read_text())))]


def test_pages_use_plain_words_and_short_sentences():
    assert not [fault for path in pages() for fault in faults(prose(path.read_text("utf-8")))]


def test_the_word_lint_detects_private_words_and_long_sentences():
    assert faults(["nothing is told of it"]) and faults([" ".join(["word"] * 31)])
    assert not faults(["The program prints " + "; ".join(["a few words"] * 20)])
