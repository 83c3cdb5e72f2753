"""What a body does: the motion of a vehicle with wheels, and the Sun's track in its body axes."""
