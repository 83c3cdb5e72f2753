"""Benchmarks of sunspin and of other software: ``python -m bench``. docs/records/bench.md explains the numbers."""
