"""Campaigns that try to break sunspin: ``python -m validation``. Not part of the package; decisions: docs/records/validation.md."""
