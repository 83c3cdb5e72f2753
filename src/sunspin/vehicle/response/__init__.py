"""Response of panels to light: `flat.py` for panels with an input each, `joined.py` for panels that share inputs."""
