"""The identity of a store depends on the source of the package."""

from sunspin.compute import identity


def test_a_changed_source_of_the_package_changes_the_identity_of_a_store(monkeypatch, tmp_path):
    before = identity.code_identity()
    (tmp_path / "compute").mkdir()
    (tmp_path / "compute" / "identity.py").write_text("")
    identity.code_identity.cache_clear()
    monkeypatch.setattr(identity, "__file__", str(tmp_path / "compute" / "identity.py"))
    try:
        changed = identity.code_identity()
        assert changed["code_sha256"] != before["code_sha256"]
        assert changed["sunspin"] == before["sunspin"]
    finally:
        identity.code_identity.cache_clear()
