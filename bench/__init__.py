"""Benchmarks of sunspin against what else could do its work: ``python -m bench``. Decisions and results: docs/records/bench.md."""
