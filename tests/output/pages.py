"""A page as a reader without a browser has it."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path


class Page(HTMLParser):
    """Elements by tag, text outside of scripts, content of the data element."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.data = ""
        self._in: str | None = None
        self._button = False
        self._sections: dict[str, list[str]] = {}
        self._open: list[str] = []
        self._buttons: list[str] = []
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._in = tag if tag in ("script", "style") else None
        self._kind = dict(attrs).get("id")
        if tag == "section":
            self._open.append(self._kind or "")
        self._button = tag == "button" and "data-filter" in dict(attrs)

    def handle_endtag(self, tag):
        self._in, self._button = None, False
        if tag == "section" and self._open:
            self._open.pop()

    def handle_data(self, data):
        if self._in is None:
            self.words.append(data)
            if self._open:
                self._sections.setdefault(self._open[-1], []).append(data)
            if self._button:
                self._buttons.append(" ".join(data.split()))
        elif self._in == "script" and self._kind == "data":
            self.data += data

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def part(self, section: str) -> str:
        """The text of the section with this id."""
        return " ".join(" ".join(self._sections[section]).split())

    def buttons(self) -> list[str]:
        """Labels of the buttons that filter rows."""
        return self._buttons

    def ids(self, tag: str) -> list[str]:
        return [attrs["id"] for name, attrs in self.tags if name == tag and attrs.get("id")]
