"""Consequences of a motion for a lander: collision, flight, first contact, wheel strategies."""
