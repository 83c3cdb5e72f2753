"""Campaigns that try to break sunspin; see docs/trust.md. Not part of the package: run as ``python -m trust``."""
