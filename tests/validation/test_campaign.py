"""Studies run as `python -m`: stored rows, and one sentence on errors."""

from __future__ import annotations

import pytest

from sunspin.base.errors import InputError
from validation.campaign import command, load_or_make, rows_folder


def test_a_row_of_a_study_is_computed_once_and_a_failed_one_is_not_kept(tmp_path):
    made = []

    def make() -> dict:
        made.append(1)
        return {"x": 0.1 + 0.2}

    def fails() -> dict:
        raise InputError("no such motion")

    folder = rows_folder(tmp_path / "a" / "b")
    rows = [load_or_make(folder / "0.json", make) for _ in range(2)]
    assert rows == [{"x": 0.1 + 0.2}] * 2
    assert len(made) == 1
    with pytest.raises(InputError, match="no such motion"):
        load_or_make(folder / "1.json", fails)
    assert [path.name for path in folder.iterdir()] == ["0.json"]


def test_a_damaged_row_is_named_and_not_used(tmp_path):
    for text in ('{"x": 1', "[1]", "\x00"):
        (tmp_path / "0.json").write_text(text, "utf-8")
        with pytest.raises(ValueError, match=r"0\.json"):
            load_or_make(tmp_path / "0.json", dict)


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [(InputError("no such motion"), 2, "no such motion"), (KeyboardInterrupt(), 130, "goes on")],
)
def test_errors_and_interruptions_of_a_study_are_one_sentence(error, code, text, capsys):
    @command
    def main(arguments: list[str] | None = None) -> None:
        raise error

    assert main([]) == code
    printed = capsys.readouterr().err
    assert text in printed and printed.count("\n") == 1
