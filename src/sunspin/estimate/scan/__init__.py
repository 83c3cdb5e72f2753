"""A grid of initial rates, each motion compared with what was measured."""
