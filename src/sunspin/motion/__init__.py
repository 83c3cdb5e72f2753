"""What would be seen: the motion of a vehicle and the Sun's track in its body axes."""
