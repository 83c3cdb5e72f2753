"""A figure inside a page: ids of its own, colours of the theme, no markup from outside."""

from xml.etree import ElementTree

from matplotlib.figure import Figure

from browser import HOSTILE
from sunspin.output.figures import COLOURS, named
from sunspin.output.figures.inline import DRAWS, inline_svg


def figure(label: str) -> Figure:
    made = Figure(figsize=(4, 3))
    axes = made.subplots()
    axes.plot([1, 2, 3], [1, 3, 2], "o-", color=COLOURS[0], label=label)
    axes.bar([1, 2], [1, 2], color=COLOURS[1], hatch="//")
    axes.imshow([[0.0, 1.0]])
    axes.set_title(label)
    axes.legend()
    return made


def test_names_from_outside_are_only_ever_drawn():
    text = inline_svg(figure(named(HOSTILE + " $\\frac{")), "a-")
    root = ElementTree.fromstring(text)
    assert {element.tag for element in root.iter()} <= DRAWS
    assert (
        "script" not in text
        and "hacked" not in text
        and "<!--" not in text
        and "metadata" not in text
    )
    for element in root.iter():
        assert (
            not [name for name in element.attrib if name.startswith(("on", "{"))]
            and not (element.text or "").strip()
        )
        assert element.get("href", "#").startswith(("#", "data:image/png;base64,"))


def test_two_drawings_share_no_id_and_refer_to_their_own():
    found = [inline_svg(figure("x"), prefix) for prefix in ("a-", "b-")]
    ids = [
        {e.get("id") for e in ElementTree.fromstring(text).iter() if e.get("id")} for text in found
    ]
    assert not ids[0] & ids[1] and all(len(known) > 10 for known in ids)
    for text, known in zip(found, ids, strict=True):
        root = ElementTree.fromstring(text)
        used = {e.get("href")[1:] for e in root.iter() if e.get("href", "").startswith("#")}
        used |= {
            part.split(")")[0]
            for e in root.iter()
            for v in e.attrib.values()
            for part in v.split("url(#")[1:]
        }
        assert used and used <= known


def test_its_colours_are_those_of_the_page():
    text = inline_svg(figure("x"), "a-")
    assert (
        "var(--blue)" in text
        and "var(--orange)" in text
        and "var(--ink)" in text
        and "#0072b2" not in text.lower()
    )
