"""The machine code of the step of `rates`: stored, loaded without numba, and never outdated."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sunspin.dynamics import machine_code, step

STEP = """
import sys
if "without numba" in sys.argv:
    sys.modules["numba"] = None
import numpy as np
from sunspin.dynamics.step import carry_bodies
steps, still = np.full((1, 1), 9), np.zeros((1, 3))
attitude, rate = carry_bodies(np.diag([0.8, 1.0, 1.2])[None, None], np.full((1, 1, 1, 3), 0.1), np.ones(1), steps, (still, still))
print(attitude.sum(), rate.sum())
"""


@pytest.fixture
def step_in_process(monkeypatch):
    """Take a step in a process of its own, with its machine code in a folder: what it prints, and whether it compiled."""

    def run(folder: Path, *arguments: str) -> tuple[str, bool]:
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
        command = [sys.executable, "-c", STEP, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return done.stdout, "compiling the step" in done.stderr

    return run


def test_stored_code_is_loaded_without_numba_and_damaged_code_is_compiled_again(
    tmp_path, step_in_process
):
    result, compiled = step_in_process(tmp_path / "new")
    assert compiled
    assert step_in_process(tmp_path / "new", "without numba") == (result, False)
    (stored,) = tmp_path.rglob("*.npz")
    whole = stored.read_bytes()
    stored.write_bytes(whole[:5000])
    assert step_in_process(tmp_path / "new") == (result, True)
    assert stored.read_bytes() == whole
    # one bit of the code
    stored.write_bytes(whole[:3000] + bytes([whole[3000] ^ 1]) + whole[3001:])
    assert step_in_process(tmp_path / "new") == (result, True)


def test_a_bit_that_calls_the_archive_encrypted_or_of_another_version_is_damage(tmp_path):
    file = tmp_path / "code.npz"
    np.savez(file, symbol=np.array("step"), code=np.zeros(9, np.uint8))
    assert machine_code._read(file) == ("step", bytes(9))
    whole = file.read_bytes()
    entry = whole.index(b"PK\x01\x02")  # of the central directory
    for byte in (6, 8, 10):  # version, flags, method
        file.write_bytes(whole[: entry + byte] + b"\x61" + whole[entry + byte + 1 :])
        assert machine_code._read(file) is None


def test_a_folder_that_cannot_be_written_costs_time_only(tmp_path, step_in_process):
    (tmp_path / "file").touch()
    result, compiled = step_in_process(tmp_path / "file")
    assert compiled and result == step_in_process(tmp_path / "folder")[0]


def test_code_of_other_sources_or_settings_is_another_file(tmp_path, monkeypatch):
    package = machine_code.PACKAGE
    digests = [machine_code._digest(step.SOURCES)]
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    digests += [machine_code._digest(step.SOURCES)]
    monkeypatch.undo()
    monkeypatch.setattr(machine_code, "PACKAGE", tmp_path)
    (tmp_path / "kernels").mkdir()
    names = ("machine_code.py", *step.SOURCES)
    for name in names:
        (tmp_path / name).write_bytes((package / name).read_bytes())
    assert machine_code._digest(step.SOURCES) == digests[0]
    for name in names:
        with (tmp_path / name).open("a") as file:
            file.write("\n")
        digests += [machine_code._digest(step.SOURCES)]
    assert len(set(digests)) == len(digests) == 5
