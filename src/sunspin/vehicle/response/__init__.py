"""How panels see light."""
