"""The vocabulary of variables: each name has one meaning."""

import csv
from importlib import resources


def test_each_variable_stands_once_in_the_vocabulary_in_order():
    text = resources.files("sunspin.base").joinpath("variables.csv").read_text("utf-8")
    names = [row["name"] for row in csv.DictReader(text.splitlines())]
    assert len(set(names)) == len(names)
    assert names == sorted(names, key=str.lower)
