"""A lander seen by its panels alone: every motion that its readings allow, found, drawn and described."""
