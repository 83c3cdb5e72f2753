"""Benchmarks of sunspin against what else could do its work: ``python -m bench``. What the numbers mean: docs/records/bench.md."""
