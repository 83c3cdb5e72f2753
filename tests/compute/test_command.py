"""Studies run as `python -m`: rows that are kept, and one sentence where something is wrong."""

from __future__ import annotations

import json

import pytest

from posteriors import philae_draws
from sunspin.base.errors import InputError, OutputError
from sunspin.compute.campaign import command, kept, rows_folder
from sunspin.estimate.posterior.tilt import AS_DRAWN
from sunspin.landing import sampling
from sunspin.output.folder import write_netcdf
from sunspin.philae import contributions, twin


def test_a_row_is_made_once_and_a_failed_one_leaves_nothing(tmp_path):
    made = []

    def make() -> dict:
        made.append(1)
        return {"x": 0.1 + 0.2}

    def fails() -> dict:
        raise InputError("no such motion")

    folder = rows_folder(tmp_path / "a" / "b")
    assert (
        kept(folder / "0.json", make) == kept(folder / "0.json", make) == {"x": 0.1 + 0.2}
        and len(made) == 1
    )
    with pytest.raises(InputError, match="no such motion"):
        kept(folder / "1.json", fails)
    assert [path.name for path in folder.iterdir()] == ["0.json"]


def test_a_damaged_row_is_named_and_not_used(tmp_path):
    for text in ('{"x": 1', "[1]", "\x00"):
        (tmp_path / "0.json").write_text(text, "utf-8")
        with pytest.raises(OutputError, match=r"0\.json"):
            kept(tmp_path / "0.json", dict)


def test_what_a_killed_run_had_begun_is_removed_and_what_lives_is_not(tmp_path):
    for process in (999999999, 1):  # none, and one that runs
        (tmp_path / f".sunspin-{process}.parts").write_text(
            f".sunspin-{process}-{'a' * 16}.part\n", "utf-8"
        )
        (tmp_path / f".sunspin-{process}-{'a' * 16}.part").write_text("{", "utf-8")
    assert {path.name for path in rows_folder(tmp_path).iterdir()} == {
        ".sunspin-1.parts",
        f".sunspin-1-{'a' * 16}.part",
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with files that are not what is asked for."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "bad.nc").write_bytes(b"\x89HDF\r\n\x1a\nno")
    tree, _ = philae_draws(3)
    write_netcdf(folder / "short.nc", tree)
    write_netcdf(folder / "other.nc", tree["posterior"].to_dataset())
    return folder


@pytest.mark.parametrize(
    ("main", "arguments"),
    [
        (contributions.main, ["{folder}/none.nc"]),
        (contributions.main, ["{folder}/bad.nc"]),
        (contributions.main, ["{folder}/other.nc"]),
        (contributions.main, ["{folder}/short.nc", "--vehicle", "{folder}/none.toml"]),
        (sampling.main, ["{folder}/bad.nc/x", "--twins", "0", "--periods", "30"]),
        (twin.main, ["{folder}/bad.nc/x.csv", "--seed", "1"]),
    ],
)
def test_errors_are_one_sentence(files, capsys, main, arguments, monkeypatch):
    monkeypatch.setattr(
        sampling,
        "widths",
        lambda *_, **__: sampling.Widths(*[sampling.np.ones((9, 13, 1))] * 2, {}, {}),
    )
    assert main([text.format(folder=files) for text in arguments]) == 2
    said = capsys.readouterr().err.strip()
    assert said and "\n" not in said and "Traceback" not in said


def test_an_interruption_says_how_to_go_on(capsys):
    @command
    def main(arguments: list[str] | None = None) -> None:
        raise KeyboardInterrupt

    assert main([]) == 130 and "the same command goes on" in capsys.readouterr().err


def test_contributions_of_another_telemetry_are_refused(tmp_path, capsys):
    tree, _ = philae_draws(3)
    tree.attrs["samples"] = 7
    path = write_netcdf(tmp_path / "posterior.nc", tree)
    assert (
        contributions.main([str(path)]) == 2
        and "not that of the posterior" in capsys.readouterr().err
    )
    assert json.loads(tree.attrs["priors_given"]) == AS_DRAWN
