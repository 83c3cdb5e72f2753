"""check, sun, rates and export need nothing that only POSIX systems have. Neither Windows nor macOS runs here.

The commands run while modules, functions and signals that Windows lacks are hidden, in all processes that they start. The source of
all modules of the package that they import is then read for such names, and for text files without a stated encoding.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import sunspin
from sunspin.base.untrusted import LIMITED_RUN

PACKAGE = Path(sunspin.__file__).parent

POSIX_MODULES = set(
    "crypt fcntl grp nis ossaudiodev pty pwd readline resource spwd syslog termios tty".split()
)
"""Modules of the standard library that Windows lacks."""

POSIX_NAMES = {
    "os": set(
        "chown chroot confstr ctermid fchmod fchown fork forkpty getegid geteuid getgid getgroups getloadavg getpgid getpgrp "
        "getpriority getresuid getsid getuid initgroups killpg lchown lockf mkfifo mknod nice O_DIRECTORY O_NOFOLLOW O_NONBLOCK "
        "openpty pathconf pread pwrite sched_getaffinity sched_setaffinity setgid setpgid setpriority setsid setuid statvfs sync "
        "sysconf uname wait wait3 wait4 waitid WIFEXITED WIFSIGNALED WNOHANG".split()
    ),
    "signal": set(
        "SIGALRM SIGCHLD SIGHUP SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGUSR1 SIGUSR2 SIGXCPU alarm getitimer pause "
        "pthread_kill pthread_sigmask setitimer sigpending sigwait".split()
    ),
    "time": {"clock_gettime", "clock_settime", "tzset"},
    "select": {"poll", "epoll", "kqueue"},
    "socket": {"AF_UNIX"},
}
"""Module -> its names that Windows or macOS lack."""

HIDDEN = {
    "os": "fork forkpty getuid geteuid sched_getaffinity killpg setsid getloadavg nice mkfifo",
    "signal": "SIGHUP SIGUSR1 SIGALRM SIGKILL alarm setitimer",
}
"""Names that are hidden while the commands run: those without which Python itself runs on this machine."""

SITE = f"""
import errno, fcntl, os, signal, sys

flush, flags = os.fsync, fcntl.fcntl
def fsync(file):
    if flags(file, 3) & os.O_ACCMODE == os.O_RDONLY:
        raise OSError(errno.EBADF, "Bad file descriptor")
    flush(file)
os.fsync = fsync

for name in {sorted(POSIX_MODULES)}:
    sys.modules[name] = None
for module, names in {HIDDEN}.items():
    for name in names.split():
        delattr(sys.modules[module], name)
"""
"""Module sitecustomize, which Python imports when any process of the commands starts.

It also refuses to flush a file that is open for reading only, as Windows does.
"""

RUN = """
import json, sys
from sunspin.cli import main
from sunspin.compute import pool

pool.may_fork = lambda: False
if __name__ == "__main__":
    for words in json.loads(sys.argv[1]):
        sys.argv = ["sunspin", *words]
        try:
            main()
        except SystemExit as end:
            assert not end.code, words
    with open("modules.txt", "w", encoding="utf-8") as file:
        print(*sys.modules, file=file)
"""
"""Program that runs commands and records the modules. Worker processes start anew, as they do where there is no fork."""

FILES = ["vehicle.toml", "telemetry.csv"]
COMMANDS = [
    ["init", "."],
    ["check", *FILES],
    ["sun", *FILES, "--out", "sun"],
    ["rates", *FILES, "--workers", "2", "--effort", "0.1", "--out", "rates"],
    ["export", "rates", "--format", "aem", "--out", "aem"],
    ["export", "rates", "--format", "netcdf", "--out", "netcdf"],
    ["check", "vehicle.toml", "rates/telemetry.nc"],  # which a separate process reads first
]


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> list[Path]:
    """Sources of all modules of the package that the commands import, which succeed with all that is POSIX only hidden."""
    folder = tmp_path_factory.mktemp("elsewhere")
    (folder / "sitecustomize.py").write_text(SITE, "utf-8")
    (folder / "run.py").write_text(RUN, "utf-8")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(PACKAGE.parent)])}
    options = {"cwd": folder, "env": environment, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "run.py", json.dumps(COMMANDS)], **options)
    assert done.returncode == 0, done.stderr
    names = {*(folder / "modules.txt").read_text("utf-8").split()}
    parts = (name.split(".")[1:] for name in names if name.startswith("sunspin"))
    places = [PACKAGE.joinpath(*part) for part in parts]
    files = [x / "__init__.py" if x.is_dir() else x.with_suffix(".py") for x in places]
    return [*files, PACKAGE / "base" / "netcdf_probe.py"]  # which runs as a program


def faults(source: str) -> Iterator[str]:
    """Yield what a source uses that another system lacks.

    An import is allowed inside `try`, a name inside a function that asks for it with `hasattr`.
    """
    tree = ast.parse(source)
    blocks = (block for block in ast.walk(tree) if isinstance(block, ast.Try))
    statements = [statement for block in blocks for statement in block.body]
    guarded = {id(node) for statement in statements for node in ast.walk(statement)}
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            calls = (node for node in ast.walk(function) if isinstance(node, ast.Call))
            asks = (call.args[1] for call in calls if getattr(call.func, "id", "") == "hasattr")
            asked = {name.value for name in asks if isinstance(name, ast.Constant)}
            uses = (node for node in ast.walk(function) if isinstance(node, ast.Attribute))
            guarded |= {id(node) for node in uses if node.attr in asked}
    for node in ast.walk(tree):
        if id(node) in guarded:
            continue
        if isinstance(node, ast.Import):
            yield from ({alias.name for alias in node.names} & POSIX_MODULES)
        elif isinstance(node, ast.ImportFrom):
            names = {alias.name for alias in node.names}
            yield from ({node.module or ""} & POSIX_MODULES)
            yield from names & POSIX_NAMES.get(node.module or "", set())
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.attr in POSIX_NAMES.get(node.value.id, ()):
                yield f"{node.value.id}.{node.attr}"
        elif isinstance(node, ast.Call):
            yield from _encoding_faults(node)


def _encoding_faults(call: ast.Call) -> Iterator[str]:
    """Yield the function of a call that opens a text file in the encoding of the system, which on Windows is not UTF-8."""
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    keywords = {keyword.arg for keyword in call.keywords}
    if "encoding" in keywords:
        return
    if isinstance(call.func, ast.Name) and name == "open":
        mode = call.args[1] if len(call.args) > 1 else ast.Constant("r")
        if not (isinstance(mode, ast.Constant) and "b" in str(mode.value)):
            yield "open without encoding"
    elif (name, len(call.args)) in (("read_text", 0), ("write_text", 1)):
        yield f"{name} without encoding"


def test_the_commands_run_without_what_windows_lacks_and_their_modules_name_nothing_of_it(sources):
    assert len(sources) > 80 and PACKAGE / "base" / "atomic_write.py" in sources
    found = {path.name: list(faults(path.read_text("utf-8"))) for path in sources}
    assert not any(found.values()), found
    # the program that limits a process runs without limits
    assert not list(faults(LIMITED_RUN)) and "import resource" in LIMITED_RUN


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        ("import fcntl", "fcntl"),
        ("from resource import setrlimit", "resource"),
        ("from os import fork", "fork"),
        ("import signal\nsignal.SIGKILL", "signal.SIGKILL"),
        ("import os\ndef count():\n    return os.sched_getaffinity(0)", "os.sched_getaffinity"),
        ("open('a')", "open without encoding"),
        ("open('a', 'w')", "open without encoding"),
        ("path.write_text(text)", "write_text without encoding"),
        ("try:\n    import fcntl\nexcept ModuleNotFoundError:\n    fcntl = None", ""),
        ("def one():\n    return os.getsid(0) if hasattr(os, 'getsid') else 1", ""),
        ("import signal\ngetattr(signal, 'SIGHUP', signal.SIGTERM)", ""),
        ("open('a', 'rb')", ""),
    ],
)
def test_reading_the_source_finds_what_another_system_lacks_and_is_not_guarded(source, fault):
    assert list(faults(source)) == ([fault] if fault else [])
