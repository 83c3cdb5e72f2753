"""How results are told: figures, reports, files for other tools."""
