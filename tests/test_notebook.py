"""Vehicles, cases and results in a notebook: valid HTML, with names from files escaped."""

from html.parser import HTMLParser

import numpy as np
import pytest

import sunspin as ss


class Checked(HTMLParser):
    """Tags must close in order; collects them and the text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.text = ""
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.tags.add(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.mark.parametrize("name", ["philae", "skcube"])
def test_a_case_shows_its_vehicle_in_a_notebook(name):
    case = ss.load_case(name)
    shown = Checked(case._repr_html_())
    assert all(panel.name in shown.text for panel in case.vehicle.panels)
    assert {"table", "td"} <= shown.tags
    if case.timeline is not None:
        assert all(event.source in shown.text for event in case.timeline.events)


def test_names_from_a_file_are_escaped_in_a_notebook():
    """An empty vehicle shows that nothing is given."""
    assert "not given" in Checked(ss.Vehicle("bare")._repr_html_()).text
    evil = "<script>alert(1)</script>"
    panel, wheel = ss.Panel(evil, [1, 0, 0], 1.0), ss.Wheel(evil, [0, 0, 1], 1e-3)
    parts = {"panels": [panel], "wheels": [wheel], "legs": [ss.Leg(evil, [0, 0, 1])]}
    craft = ss.Vehicle(evil, np.eye(3), gain_unit=evil, **parts)
    shown = Checked(craft._repr_html_())
    assert "script" not in shown.tags and shown.text.count(evil) >= 4
