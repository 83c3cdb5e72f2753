"""What a store's name depends on: the text of the package, too."""

from sunspin.compute import identity


def test_another_text_of_the_package_is_another_identity(monkeypatch, tmp_path):
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
