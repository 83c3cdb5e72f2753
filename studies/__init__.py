"""What else was asked of the paper: each study is `python -m studies.NAME OUT`, its table and picture stand in docs/studies.md."""
