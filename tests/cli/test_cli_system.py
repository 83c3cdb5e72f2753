"""The command line and the system: option values, interruption, closed pipes, folders, JSON."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import click
import numpy as np
import pytest

from sunspin import cli
from sunspin.base.errors import InputError, OutputError
from sunspin.cli import interruption, values
from sunspin.cli.common import COMMANDS
from sunspin.output.folder import results_folder
from sunspin.planning import plan
from tests.support.rows import ELSEWHERE, heed_interrupts
from validation import border


def sunspin(*arguments):
    """Run the entry point in this process: exit code, standard output, standard error."""
    return border.sunspin(*map(str, arguments))[:3]


def refused(outcome, *words):
    code, out, err = outcome
    assert (code, out) == (2, "")
    assert err.startswith("sunspin: error: ") and err.count("\n") == 1
    for word in words:
        assert word in err


NO_PRIOR = r"takes a number \(found nothing\); for example --prior inertia=0.1"
NO_GYRO = r"5 numbers .*\(found 0,1,2\); for example --gyro-deg-s 0.1,0,-0.2,1,0.5"


@pytest.mark.parametrize(
    ("read", "given", "option", "text"),
    [
        (values.parse_times, "soon", None, "--predict takes s from the epoch, or UTC"),
        (values.parse_period, "13+-1@noon", None, "--period takes s from the epoch, or UTC"),
        (values.parse_prior, "inertia", "--prior", NO_PRIOR),
        (values.parse_observation, "0,1,2", "--gyro-deg-s", NO_GYRO),
    ],
)
def test_an_invalid_option_value_is_refused_with_its_form(read, given, option, text):
    with pytest.raises(InputError, match=text):
        read(given, option)


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Return the files of `sunspin init mine`, below the folder where the commands run."""
    monkeypatch.chdir(tmp_path)
    sunspin("init", "mine")
    return Path("mine/vehicle.toml"), Path("mine/telemetry.csv")


GRID = "--omega-x-deg-s must be low:high:step in deg/s"
NO_SAMPLES = "no samples lie between"
PHASE = "no such phase (found descnt)"
NO_TELEMETRY = "this is a vehicle's file and not telemetry"
MINE = "mine/vehicle.toml mine/telemetry.csv"
SIMULATE = "simulate philae --omega-deg-s=6,0,0 --sun=0.1959,0.5690,0.7986 --duration=10"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("sun philae philae --noise=x", ["'x' is not a number"]),
        ("sun philae philae --noise=nan", ["is not a number such as -1.5e-3"]),
        ("sun philae philae --noise=1e300", ["--noise must be a finite number between"]),
        ("rates philae philae --pass=1.5", ["'1.5' is not a whole number"]),
        (f"rates {MINE} --pass 5", ["no such pass (found 5)", "passes 0 to 0"]),
        (f"rates {MINE} --from 2030-01-01T00:00", [NO_SAMPLES, "2026-01-01T00:12:58Z"]),
        (f"rates {MINE} --to noon:", ["ISO-8601", "noon:"]),
        ("outcomes philae --runs=1 --strategy=", ["the value is empty"]),
        ("outcomes philae --runs=1 --strategy=delay:1e308", ["a delay must be"]),
        (f"{SIMULATE}e8", ["larger --step"]),
        (f"{SIMULATE} --step=0", ["--step"]),
        (f"{SIMULATE} --wheel-speed=1,2", ["wheel"]),
        (f"{SIMULATE} --wheel-mode=fly", ["--wheel-mode", "coast"]),
        ("scan philae philae --omega-x-deg-s=0:60", [GRID, "(found 0:60)", "-deg-s=-6:6:1"]),
        ("posterior philae --phase descnt", [PHASE, "descent", "first_rebound"]),
        ("check mine/telemetry.csv mine/vehicle.toml", ["telemetry.csv", "comes first"]),
        ("check mine/vehicle.toml mine/vehicle.toml", [NO_TELEMETRY, "a table of samples"]),
    ],
)
def test_what_does_not_fit_an_option_or_its_file_is_refused_in_one_sentence(mine, command, words):
    refused(sunspin(*command.split()), *words)


BUFFERED = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
"""As users have it: what is printed is written at the end."""


@pytest.mark.parametrize(
    ("words", "code", "printed"),
    [
        ("init {folder} >&-", 0, 0),
        ("check nowhere.toml >&-", 2, 1),
        ("init {folder} >/dev/full", 2, None),
        ("check nowhere.toml 2>/dev/full", 2, 0),
        ("--version >/dev/full 2>/dev/full", 2, 0),
        pytest.param("init {folder} 2>&-", 0, 0, marks=pytest.mark.long),
        pytest.param("check nowhere.toml >&- 2>&-", 2, 0, marks=pytest.mark.long),
    ],
)
def test_closed_or_full_output_ends_the_program_without_a_traceback(tmp_path, words, code, printed):
    """An error that cannot be printed keeps its exit code; `printed`: lines on standard error, None: any number."""
    line = f'"{sys.executable}" -m sunspin.cli {words.format(folder=tmp_path / "mine")}'
    command = ["/bin/sh", "-c", line]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=BUFFERED)
    assert done.returncode == code
    assert bool(done.stdout) is ("init" in words and words.endswith("2>&-"))
    assert "Traceback" not in done.stderr and "defect" not in done.stderr
    assert printed is None or done.stderr.count("\n") == printed


def test_sunspin_without_arguments_shows_the_help():
    code, out, err = sunspin()
    assert (code, err) == (0, "")
    assert out.startswith("Usage: sunspin") and "reproduce" in out


@pytest.mark.evidence("check", "modelled", "samples with a dead panel")
def test_check_names_the_panel_that_explains_impossible_patterns():
    """The paper's own conclusion: after the second touchdown panel 1 was shaded."""
    telemetry = Path(__file__).parents[1] / "philae" / "panels_as_drawn.csv"
    code, out, _ = sunspin("check", "philae", telemetry, "--json")
    about = json.loads(out)["telemetry"]
    assert code == 0 and about["synthetic"] is True
    assert set(about["impossible"]) == {"2-3-6", "2-3", "2"}
    assert about["explanations"] == [["1"]]
    assert set(about["noise_probability"]) == set(about["impossible"])
    assert max(about["noise_probability"].values()) == pytest.approx(0.05, abs=0.01)
    assert sum(about["status"].values()) == about["samples"]


def test_check_counts_the_flagged_samples(mine):
    vehicle, telemetry = mine
    rows = telemetry.read_text().splitlines()
    rows[3] = rows[3].split(",", 1)[0] + ",-3,0,0,0,1"
    telemetry.write_text("\n".join(rows) + "\n")
    refused(sunspin("check", *mine), "telemetry.csv", "-3")
    vehicle.write_text(vehicle.read_text().replace('bad_rows = "refuse"', 'bad_rows = "flag"'))
    assert "1  flagged: negative" in sunspin("check", *mine)[1]
    telemetry.write_text("\n".join([*rows[:20], *rows[9:12], *rows[20:]]) + "\n")
    said = sunspin("check", *mine)[1]
    assert "3  duplicate rows merged" in said
    assert "flagged: time_not_increasing" not in said
    assert "sampling interval: 14 s min" in said
    again = [rows[9].rsplit(",", 1)[0] + ",0.77"]
    telemetry.write_text("\n".join([*rows[:20], *again, *rows[20:]]) + "\n")
    assert "1  flagged: time_not_increasing" in sunspin("check", *mine)[1]


def test_check_prints_the_time_of_the_first_sample_and_the_epoch(mine):
    vehicle, _ = mine
    text = vehicle.read_text().replace('# epoch_utc = "2026-01-01', 'epoch_utc = "2025-12-31')
    vehicle.write_text(text)
    said = sunspin("check", *mine)[1]
    assert "from 2026-01-01T00:00:00Z" in said
    assert "time zero: 2025-12-31T00:00:00Z, 86400 s before" in said
    assert sunspin("check", *mine, "--quiet") == (0, "", "")


def test_a_missing_telemetry_file_is_looked_for_in_the_data_folder(mine, monkeypatch):
    monkeypatch.delenv("SUNSPIN_DATA", raising=False)
    command = "check", mine[0], "telemetry.csv"
    refused(sunspin(*command), "telemetry.csv")
    assert sunspin(*command, "--data", "mine")[0] == 0
    monkeypatch.setenv("SUNSPIN_DATA", "mine")
    assert sunspin(*command)[0] == 0


def test_init_writes_both_files_or_none(tmp_path):
    (tmp_path / "telemetry.csv").symlink_to(tmp_path / "nowhere")  # exists, though it leads nowhere
    refused(sunspin("init", tmp_path), "telemetry.csv", "already")
    assert not (tmp_path / "vehicle.toml").exists()
    (tmp_path / "file").write_text("not a folder")
    refused(sunspin("init", tmp_path / "file" / "mine"), "choose another folder")
    assert sunspin("init", tmp_path / "mine", "--quiet") == (0, "", "")


def test_a_folder_with_other_results_is_refused_before_the_computation(mine, monkeypatch):
    import sunspin.estimate.scan.volume as scan

    def never(*_, **__):
        raise AssertionError("the scan ran although its results could not be written")

    monkeypatch.setattr(scan, "scan", never)
    refused(sunspin("scan", *mine, "--out", mine[0].parent), "not empty", "--out")


def test_a_closed_pipe_is_no_error():
    command = [sys.executable, "-m", "sunspin", "check", "philae", "--json"]
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "kind", [signal.SIGINT, signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.long)]
)
def test_an_interruption_prints_one_sentence_and_exits_with_130(kind, tmp_path):
    """Also where somebody ends the process or closes its terminal; its copies end with it."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "sunspin.cli", "reproduce", "--quiet", "--out", out]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, preexec_fn=heed_interrupts, start_new_session=True, **pipes)
    try:
        # the marker is written when the work begins
        while not out.exists() and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(kind)
        printed, complaint = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130, complaint
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)
    assert complaint.count("\n") == 1 and "interrupted" in complaint and printed == ""
    left = [path.name for path in out.iterdir()] if out.exists() else []
    assert not [name for name in left if name.endswith((".part", ".html"))]


@pytest.mark.parametrize("stopped", [True, False])
def test_an_error_of_a_library_during_an_interruption_is_reported_as_that(monkeypatch, stopped):
    """Ctrl-C in the middle of an import may be caught there, and end in another error."""

    def stumble(**_):
        try:
            if stopped:
                interruption.stop()
        except KeyboardInterrupt:
            pass
        raise AttributeError("module 'half' has no attribute 'there'")

    unset = threading.Event()
    monkeypatch.setattr(interruption, "STOPPED", unset)
    monkeypatch.setattr(cli, "STOPPED", unset)
    monkeypatch.setattr(cli.cli, "main", stumble)
    code, _, said = sunspin()
    expected = (130, True, False) if stopped else (1, False, True)
    assert (code, "interrupted" in said, "defect" in said) == expected


def test_an_interruption_that_a_library_swallows_is_raised_again(monkeypatch):
    def swallow(**_):
        try:
            interruption.stop()
        except:  # noqa: E722, as libraries have it
            time.sleep(2 * interruption.AGAIN_S)  # alive meanwhile: not raised twice
        time.sleep(30)

    monkeypatch.setattr(interruption, "AGAIN_S", 0.05)
    monkeypatch.setattr(cli.cli, "main", swallow)
    begin = time.monotonic()
    code, _, said = sunspin()
    assert (code, said.count("\n"), time.monotonic() - begin < 10) == (130, 1, True)
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


FROM_TEXT = "exec('interruption.stop()')"
WITH_THREAD = """
    from concurrent.futures import ThreadPoolExecutor
    ThreadPoolExecutor(1, interruption.THREADS).submit(time.sleep, 60)
    interruption.stop()
"""


@pytest.mark.parametrize("work", [FROM_TEXT, WITH_THREAD], ids=["from a text", "with a thread"])
def test_an_interruption_in_code_from_a_text_or_beside_a_thread_leaves_the_exit_code(
    tmp_path, work
):
    """Python would end by the signal instead, so that a shell sees no exit code, or wait for threads that compute."""
    begin = "import time\nfrom sunspin.cli import cli, main, interruption\n"
    program = f"{begin}def work(**_):\n    {work}\ncli.main = work\nmain()\n"
    (tmp_path / "program.py").write_text(program)
    command = [sys.executable, "-m", "program"]
    options = {"cwd": tmp_path, "env": ELSEWHERE, "capture_output": True, "text": True}
    done = subprocess.run(command, timeout=30, **options)
    assert (done.returncode, done.stderr.count("\n")) == (130, 1)


def test_an_interrupted_plan_prints_its_complete_rounds_and_exits_with_130(monkeypatch):
    def interrupted(*arguments, **options):
        result = plan(*arguments, **options | {"samples": 3, "passes": 1})
        return result.assign_attrs(interrupted=1)

    monkeypatch.setattr("sunspin.planning.plan", interrupted)
    code, printed, said = sunspin("plan", "skcube", "--every", "10", "--passes", "2", "--quiet")
    assert (code, said) == (130, "sunspin: interrupted, 1 of 2 rounds are complete and printed\n")


def test_the_option_for_observed_rates_of_the_posterior_is_in_deg_s():
    seen = values.parse_observation("5,180,0,-90,18", "--gyro-deg-s")
    assert seen["t_s"] == 5 and seen["sigma"] == pytest.approx(np.pi / 10)
    assert seen["value"] == pytest.approx([np.pi, 0, -np.pi / 2])


NO_TEXT = (click.types.BoolParamType, click.types.Choice)


def takers():
    """Every command with every option and argument that takes a text."""
    for name in COMMANDS:
        command = cli.cli.get_command(click.Context(cli.cli), name)
        for parameter in command.params:
            if not isinstance(parameter.type, NO_TEXT) and not getattr(parameter, "is_flag", False):
                yield name, command, parameter


@pytest.mark.parametrize("empty", ["", " ", "\t"])
def test_no_option_or_argument_takes_an_empty_text(empty, tmp_path, monkeypatch):
    """As a path an empty text is the present folder: `init ""` wrote there."""
    monkeypatch.chdir(tmp_path)
    texts = list(takers())
    for name, command, parameter in texts:
        arguments = [one for one in command.params if isinstance(one, click.Argument)]
        before = [empty if one is parameter else "philae" for one in arguments]
        option = [] if isinstance(parameter, click.Argument) else [parameter.opts[0], empty]
        outcome = sunspin(name, *before, *option)
        refused(outcome, f"Invalid value for '{option[0] if option else ''}", "the value is empty")
    assert len(texts) > 100 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_a_name_with_unprintable_characters_is_escaped(encoding, tmp_path):
    command = [sys.executable, "-m", "sunspin.cli", "init", str(tmp_path / "caf\u00e9\u2603")]
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(command, env=environment, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    assert ("caf\u00e9\u2603" if encoding == "utf-8" else "\\u2603") in done.stdout.decode(encoding)


def test_a_path_of_thousands_of_folders_is_refused(undrawn):
    """They are made from within, each by a call in the call before, of which Python allows a thousand."""
    deep, words = "d/" * 1500 + "x", "no folder can have this name"
    refused(sunspin("init", deep), words)
    refused(sunspin("sun", "philae", "philae", "--out", deep), words)
    with pytest.raises(OutputError, match=f"results cannot be written here .{words}."):
        results_folder("a\0b", "sun")
