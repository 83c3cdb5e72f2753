"""What was seen: files, their quality, and the Sun directions that the panels' powers give."""
