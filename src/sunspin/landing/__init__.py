"""What a motion means for a lander: collision, flight, contact, wheel strategies."""
