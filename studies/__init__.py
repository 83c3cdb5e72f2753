"""Studies of the paper, of real satellites and of the posterior: each is `python -m studies.NAME`, and `--help` lists its options.

Tables and pictures of the studies of the paper stand in docs/studies.md.
"""
