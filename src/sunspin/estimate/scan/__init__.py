"""Scan of initial body rates: a grid of motions, each compared with the measured directions to the Sun."""
