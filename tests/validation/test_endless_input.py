"""Input that would never end: devices, pipes, system files, and priors with too many starts."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from validation.border import CommandResult, judge, sunspin

DEVICES = "/proc/kmsg", "/dev/zero", "/dev/null", "/dev/stdin", "/dev/full", "/proc/self/mem"
KERNEL = [path for path in DEVICES if Path(path).exists()]


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert sunspin("init", ".", "--quiet") == CommandResult(0, "", "")
    os.mkfifo("pipe")
    Path("link").symlink_to("pipe")
    Path("pipes").mkdir()
    for k in range(20):
        os.mkfifo(f"pipes/1403600000_OM3KAA_{k}")
    return tmp_path


@pytest.fixture
def soon():
    """A test that waits for ever fails."""

    def over(*_):
        raise AssertionError("this does not end")  # an OSError would become a sentence

    before = signal.signal(signal.SIGALRM, over)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


COMMANDS = [f"{name} vehicle.toml {{}}" for name in ("check", "sun", "rates", "posterior", "scan")]
COMMANDS += ["check {}", "report {}", "decode {} --out out", "export {} --out out"]
COMMANDS += ["outcomes philae --scan {}"]


@pytest.mark.parametrize("command", COMMANDS)
def test_devices_pipes_and_files_of_the_kernel_are_refused(command, home, soon):
    for path in (*KERNEL, "pipe", "link", "pipes"):
        told = sunspin(*command.format(path).split())
        assert judge(told).what == "refused", (path, told)
        said = "device or a pipe" in told.err or "there is no such" in told.err
        assert said or path != "pipe", told


def test_results_folders_made_of_pipes_are_refused(home, soon):
    (home / ".sunspin-results").write_text("rates\n")
    (home / "manifest.json").write_text('{"data": ["rates.nc"]}')
    for name in ("rates.nc", "summary.json", "timeline.toml"):
        os.mkfifo(name)
    assert judge(sunspin("export", ".", "--out", "out")).what == "refused"
    assert judge(sunspin("report", ".")).what == "refused"


def test_telemetry_can_be_piped_in(home, monkeypatch):
    content = (home / "telemetry.csv").read_bytes()
    by_name = sunspin("sun", "vehicle.toml", "telemetry.csv", "--json")
    piped = sunspin("sun", "vehicle.toml", "-", "--json", piped=content)
    assert piped.code == 0 and json.loads(piped.out)["status"] == json.loads(by_name.out)["status"]
    monkeypatch.setattr("sunspin.base.tables.MAX_FILE_BYTES", 10_000)
    monkeypatch.setattr("sunspin.cli.common.PIECE", 1000)
    for endless, words in ((20 * content, "is smaller than 0.01 MB"), (b"", "empty")):
        told = sunspin("check", "vehicle.toml", "-", piped=endless)
        assert judge(told).what == "refused" and words in told.err, told
