"""Compiled kernels: generated source in a module named by the hash of that source.

numba's disk cache keys a function by its file and its time stamp and does not notice changes in what it inlines from
elsewhere. A module whose name is the hash of everything in it can be cached for good: an edit to the physics is another
module.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
import threading
from collections.abc import Callable
from enum import IntEnum
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

from sunspin.base.atomic_write import ensure_writable, write_atomically
from sunspin.compute.identity import code_identity
from sunspin.dynamics.ensemble import codegen as c
from sunspin.dynamics.ensemble import series_lanes
from sunspin.dynamics.ensemble.deposit import deposit_body, signed_body
from sunspin.dynamics.ensemble.lanes import LANE_WHEEL_ROWS, NODE_ROWS, Lanes
from sunspin.dynamics.ensemble.series_lanes import ORDER, SeriesLanes
from sunspin.dynamics.ensemble.split_lanes import TIMES, SplitLanes
from sunspin.dynamics.processor import compiler

_lock = threading.Lock()


class Outcome(IntEnum):
    """How a row ended; the text is in `OUTCOME_TEXT`."""

    FINE = 0
    CHATTERS = 1
    PAST_UNKNOWN = 2
    NOT_FINITE = 3


OUTCOME_TEXT = {
    Outcome.FINE: "computed as asked",
    Outcome.CHATTERS: "a wheel stops and starts too often to be followed",
    Outcome.PAST_UNKNOWN: "running backward, a wheel comes to rest: its past is not determined",
    Outcome.NOT_FINITE: "the motion left the range of numbers",
}

NOT_IN_ALL = "S_SPIN S_INVERSE S_DIFFERENCE S_HELD S_AXES S_LOW S_WEAR S_SPEEDS S_SIZE".split()
"""Rows that only one of the methods has."""

METHODS: dict[str, type[Lanes]] = {"series": SeriesLanes, "split": SplitLanes}

EVENT_ORDER = {"series": ORDER, "split": 8}
"""Order of the Taylor step of one trajectory through an event: at least as accurate as the lanes' own."""

EVENT_TOLERANCE = {"series": 1e-13, "split": 1e-5}
"""Of the place of an event in its step, and of the value there compared with that at the step's begin."""


def source(structure: c.Structure, lanes: int | None = None) -> str:
    """The complete source of the kernel for this structure, for the method's number of lanes or another (1, or a multiple of 4)."""
    o = METHODS[structure.method](structure, lanes)
    bodies = {
        "        pass  # STEP": o.step(),
        "    pass  # HALVE": o.halve(),
        "        pass  # BREAK_AWAY": o.break_away(),
        "        pass  # SIGNED": signed_body(o) if structure.bins else [],
        "                pass  # DEPOSIT_ALL": [],
        "    pass  # STEP_ONE": c.step_one_body(structure, EVENT_ORDER[structure.method]),
        "    pass  # SPIN_ONE": c.spin_one_body(structure),
        "    pass  # ABOUT": c.about_body(structure),
        "    pass  # ABOUT_NEW": [
            f"H, r = NEW{f' + {structure.axis}' if structure.axis else ''}, NEW + 3 + N_WHEELS"
        ],
        "    pass  # OBSERVE_ONE": c.observe_one_body(structure),
        "    pass  # OMEGA_ONE": c.omega_body(structure),
        "    pass  # SPEEDS_ONE": c.speeds_body(structure),
    }
    deposits = []
    for node in range(o.nodes if structure.bins else 0):
        lines = "\n".join("        " + line for line in deposit_body(o, node))
        deposits.append(
            f"@estimate\ndef deposit_{node}(v, normals, bins, weights):\n    for j in range(LANES):\n{lines}\n\n\n"
        )
        # in a loop over nodes the choice between the functions would cost as much as a third of them
        calls = [f"deposit_{node}(v, normals, bins, weights)", "add_up(bins, weights, hist)"]
        bodies["                pass  # DEPOSIT_ALL"] += calls
    parts = {
        "CONSTANTS": o.definitions(),
        "EVENTS": template("events"),
        "METHOD": template(structure.method),
        "DEPOSITS": "".join(deposits).rstrip(),
    }
    text = template("driver")
    for name, part in parts.items():
        text = text.replace(f'\n"{name}"\n', f"\n{part}\n")
    for name, value in _constants(structure, o).items():
        text = text.replace(f'\n{name} = "{name}"', f"\n{name} = {value}")
    torques = o.load_torques()
    text = text.replace("    pass  # LOAD_TORQUES\n", "".join(f"    {line}\n" for line in torques))
    for marker, lines in bodies.items():
        indent = marker[: len(marker) - len(marker.lstrip())]
        text = text.replace(
            marker + "\n", ("\n".join(indent + line for line in lines) or f"{indent}pass") + "\n"
        )
    return text


def template(name: str) -> str:
    """The hand-written text of this name, as it stands in its file."""
    return Path(__file__).with_name(f"{name}_template.py").read_text(encoding="utf-8")


def _constants(structure: c.Structure, o: Lanes) -> dict[str, object]:
    """Numbers of the layouts by their names in the templates."""
    rows = structure.layout
    return {
        **dict.fromkeys(NOT_IN_ALL, 0),
        **o.at,
        "TIMES": repr(TIMES),
        "FLOAT": f"np.{structure.precision}",
        "LANES": o.lanes,
        "NODES": o.nodes,
        "LANE_WHEEL_ROWS": len(LANE_WHEEL_ROWS),
        "NODE_ROWS": NODE_ROWS,
        "N_WHEELS": rows.n_wheels,
        "N_STATE": rows.n_state,
        "ROWS": rows.count,
        "NEW": rows.new,
        "DT": rows.dt,
        "BODY": rows.body,
        "SPIN": rows.spin,
        "COMMON": rows.spin if structure.method == "series" else rows.frame + 1,
        "MODE_NUMBERS": rows.held - rows.spin,
        "INVERSE": rows.inverse,
        "FRAME": rows.frame,
        "HELD": rows.held,
        "WHEEL": rows.wheel(0),
        "PER_WHEEL": len(c.WHEEL_ROWS),
        "BINS": structure.bins,
        "EVENT_TOLERANCE": EVENT_TOLERANCE[structure.method],
        **{name.upper(): offset for offset, name in enumerate(c.WHEEL_ROWS)},
        **{outcome.name: int(outcome) for outcome in Outcome},
    }


def cache_folder() -> Path:
    """Where generated modules and their machine code are kept: the user's cache, or a private temporary folder."""
    folder = lasting_folder()
    return folder if ensure_writable(folder) else _private_folder()


def lasting_folder() -> Path:
    """Where they are kept from one process to the next, if it can be written."""
    base = (
        os.environ.get("SUNSPIN_CACHE")
        or os.environ.get("XDG_CACHE_HOME")
        or str(Path.home() / ".cache")
    )
    return Path(base) / "sunspin" / "kernels"


@lru_cache(maxsize=1)
def _private_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="sunspin-kernels-"))


@lru_cache(maxsize=32)
def kernel(structure: c.Structure) -> ModuleType:
    """The module with the compiled function `run` for this structure."""
    return module_of(kept_source(structure), compiler())


def kept_source(structure: c.Structure) -> str:
    """`source(structure)`, kept."""
    return kept_text((structure, series_lanes.ORDER), lambda: source(structure))


def kept_text(made_from: tuple[Any, ...], make: Callable[[], str]) -> str:
    """Generated source, from the cache folder where the same code has made it before: with SymPy it takes up to a second."""
    made_from = (*made_from, code_identity()["code_sha256"], metadata.version("sympy"))
    path = cache_folder() / f"source_{_digest(repr(made_from))}.txt"
    if path.exists():
        digest, _, text = path.read_text(encoding="utf-8").partition("\n")
        if digest == _digest(text):
            return text
    text = make()
    write_atomically(
        path, lambda part: part.write_text(f"{_digest(text)}\n{text}", encoding="utf-8")
    )
    return text


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def module_of(text: str, made_by: str) -> ModuleType:
    """The module with this text, from the cache folder if it is there; `made_by` says what its machine code is made by and for."""
    name = "sunspin_kernel_" + _digest(f"{made_by}\n{text}")
    with _lock:
        if name in sys.modules:
            return sys.modules[name]
        path = cache_folder() / f"{name}.py"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_atomically(path, lambda part: part.write_text(text, encoding="utf-8"))
        return loaded(name, path)


def loaded(name: str, path: Path | str) -> ModuleType:
    """The module in a Python file, run and entered among the modules of this process."""
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
