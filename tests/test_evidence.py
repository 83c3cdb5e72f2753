"""The page "Evidence" shows what the tests declare and reach."""

import pytest

from docs.evidence_page import KINDS, capabilities, declared, page


def test_every_capability_has_a_line_and_one_without_evidence_says_none(monkeypatch):
    monkeypatch.setattr("docs.evidence_page.declared", lambda: [])
    text = page(None)
    assert len(capabilities()) >= 25
    for name in capabilities():
        line = f"| [{name}](#{name.replace('_', '-')}) | **none** |"
        assert f"## {name}\n" in text and line in text
    assert "not run before this page was built" in text


def test_evidence_for_what_does_not_exist_is_refused(monkeypatch):
    known = declared()
    assert {each.kind for each in known} == set(KINDS)  # else the three words part nothing
    wrong = known[0]._replace(capability="mind_reading")
    monkeypatch.setattr("docs.evidence_page.declared", lambda: [wrong])
    with pytest.raises(ValueError, match="mind_reading"):
        page(None)
