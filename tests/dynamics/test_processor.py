"""The cache of compiled code: kept, announced once, and never outdated."""

import os
import subprocess
import sys

HELPER = """
from sunspin.dynamics.processor import compiled

@compiled
def double(x):
    return 2 * x
"""

ENTRY = """
import helper
from sunspin.dynamics.processor import cached, digest

def _entry(sources):
    @cached("compiling, once")
    def run(x):
        _ = sources
        return helper.double(x)
    return run

run = _entry(digest(__file__, helper.__file__))
print(run(3), sum(run.stats.cache_hits.values()))
"""


def run_in(folder) -> tuple[list[str], str]:
    """Run the entry point in a process of its own: result and hits of the cache, and what was said."""
    done = subprocess.run(
        [sys.executable, "entry.py"], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.split(), done.stderr.strip()


def test_compiled_code_is_kept_until_a_source_in_any_file_changes(tmp_path):
    """Of a class that is renamed in the same line of its file the name of numba's index stays."""
    helper = "from typing import NamedTuple\nclass Pair(NamedTuple):\n    x: int\n" + HELPER
    entry = ENTRY.replace("double(x)", "double(x.x)").replace("run(3)", "run(helper.Pair(3))")
    changed = helper.replace("2 * x", "5 * x")
    for seconds, (name, source, result, hits) in enumerate(
        (
            ("Pair", helper, "6", 0),
            ("Pair", helper, "6", 1),
            ("Pair", changed, "15", 0),
            ("Couple", changed, "15", 0),
        )
    ):
        (tmp_path / "helper.py").write_text(source.replace("Pair", name))
        (tmp_path / "entry.py").write_text(entry.replace("Pair", name))
        # Python itself takes a file of the same size and of the same second for the same file
        os.utime(tmp_path / "helper.py", (1e9 + seconds, 1e9 + seconds))
        assert run_in(tmp_path) == ([result, str(hits)], "" if hits else "compiling, once")


def test_a_folder_without_room_for_a_cache_costs_time_only(tmp_path):
    (tmp_path / "helper.py").write_text(HELPER)
    text = "import numba.core.caching as c\nc.CacheImpl._locator_classes = []\n"
    (tmp_path / "entry.py").write_text(text + ENTRY)
    assert run_in(tmp_path) == (["6", "0"], "compiling, once")
