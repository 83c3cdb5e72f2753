"""``python -m bench``: run the benchmarks, print their tables, write them as JSON."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from bench import machine
from bench.table import Table
from bench.timing import say

NAMES = ("start", "scan", "peak", "emd", "accuracy")
"""Fresh processes first, before this one has filled caches and warmed the processor."""

RESULTS = Path(__file__).with_name("results")


def benchmark(name: str) -> Callable[[bool], Table]:
    """The benchmark of this name: a function of `quick`."""
    return import_module(f"bench.{name}").run


def main(arguments: Sequence[str] | None = None) -> Path:
    """Run what was asked for; the path of the JSON file."""
    options = _options(arguments)
    where = machine.description()
    print(machine.line(where), flush=True)
    tables, seconds = [], {}
    for name in options.only:
        start = time.perf_counter()
        table = benchmark(name)(options.quick)
        seconds[name] = time.perf_counter() - start
        tables.append(table)
        print(f"\n{table.text()}", flush=True)
    say(f"done in {sum(seconds.values()):.0f} s")
    path = options.json or RESULTS / f"{time.strftime('%Y%m%d-%H%M%S')}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    result = {
        "machine": where,
        "quick": options.quick,
        "seconds": seconds,
        "tables": {table.name: table.as_json() for table in tables},
    }
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    say(f"results: {path}")
    return path


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench", description="Benchmarks of sunspin; see docs/benchmarks.md."
    )
    parser.add_argument(
        "--quick", action="store_true", help="small sizes and few repeats, under a minute"
    )
    parser.add_argument(
        "--only",
        type=_names,
        default=list(NAMES),
        metavar="NAME[,NAME]",
        help=f"some of {', '.join(NAMES)}",
    )
    parser.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="where to write the results (default: bench/results/)",
    )
    return parser.parse_args(arguments)


def _names(text: str) -> list[str]:
    chosen = text.split(",")
    unknown = [name for name in chosen if name not in NAMES]
    if unknown:
        raise argparse.ArgumentTypeError(
            f"no benchmark {', '.join(unknown)}; there are {', '.join(NAMES)}"
        )
    return [name for name in NAMES if name in chosen]


if __name__ == "__main__":
    main()
