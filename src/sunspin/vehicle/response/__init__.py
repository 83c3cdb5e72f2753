"""How panels see light: `flat.py` answers for panels each on an input of its own, `joined.py` where panels share inputs."""
