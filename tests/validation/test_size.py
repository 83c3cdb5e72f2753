"""The report of lines, functions and names."""

from validation import size


def test_the_size_report_counts_a_small_package(tmp_path):
    (tmp_path / "room").mkdir()
    (tmp_path / "__init__.py").write_text("from pkg.room import shown\n", "utf-8")
    (tmp_path / "room" / "first.py").write_text(
        "LIMIT, OTHER = 1, 2\n\n\nclass Same:\n    pass\n\n\ndef shown(one):\n    found = helper(one)\n    return found\n",
        "utf-8",
    )
    (tmp_path / "room" / "second.py").write_text(
        "SMALL: int = 3\nlower = 4\n\n\nclass Same:\n    pass\n\n\ndef helper(x):\n    return twice(x) + twice(x)\n\n\n"
        "def twice(x):\n    return shown(x)\n",
        "utf-8",
    )
    room = size.measure_folders(tmp_path)["room"]
    assert (room.files, room.lines, room.functions, room.classes) == (2, 24, 3, 2)
    assert room.single_caller == 1  # helper: twice is used twice, and shown is exported
    assert (room.repeated_classes, room.constants) == (1, 3)
    # one as a parameter and where it is used, found as it is set and returned
    assert room.vague_names == 4
    whole = size.measure_folders(tmp_path)["src"]
    assert (whole.files, whole.lines) == (3, 25)
