"""Raw frames of satellites into rows, a decoder a file."""
