"""Unknown commands, options and names are refused with the nearest known one."""

import pytest

import sunspin as ss
from tests.support.commands import sunspin


def test_an_unknown_command_is_answered_with_the_nearest_one(tmp_path):
    assert "did you mean rates" in sunspin("ratse", cwd=tmp_path, code=2).err


def test_an_unknown_option_is_answered_with_the_nearest_one(tmp_path):
    done = sunspin("rates", "v.toml", "t.csv", "--max-rate", "1", cwd=tmp_path, code=2)
    assert "--max-rate-deg-s" in done.err and done.err.count("\n") == 1


def test_an_unknown_name_of_the_package_is_answered_with_the_nearest_one():
    said = "no attribute 'posteriors'; did you mean 'posterior'?"
    with pytest.raises(AttributeError, match=said):
        _ = ss.posteriors
    with pytest.raises(AttributeError, match="no attribute 'xyzzy'$"):
        _ = ss.xyzzy
