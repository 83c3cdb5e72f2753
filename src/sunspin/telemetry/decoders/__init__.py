"""Decoders that turn raw frames of satellites into rows; one module for each format."""
