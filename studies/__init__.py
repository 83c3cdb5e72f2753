"""Studies beyond the paper. Each runs as `python -m studies.NAME OUT`; docs/studies.md has their tables and pictures."""
