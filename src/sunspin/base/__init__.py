"""Foundations of the package: errors, safe reading of files, atomic writing, tables, provenance."""
