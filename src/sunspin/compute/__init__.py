"""Computation of many rows on many cores or a cluster: chunks, resuming, the identity of a result."""
