"""Campaigns that try to break sunspin; see docs/records/validation.md. Not part of the package: run as ``python -m validation``."""
