"""Entry point of ``python -m sunspin``."""

from sunspin.cli import main

main()
