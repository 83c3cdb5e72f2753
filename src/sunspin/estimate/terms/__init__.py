"""One file for each kind of sensor or torque: what it would read of a motion, and how that changes with the motion."""
