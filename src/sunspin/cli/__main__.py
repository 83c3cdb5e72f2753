"""Entry point of ``python -m sunspin.cli``."""

from sunspin.cli import main

main()
