"""How a spacecraft moved, estimated from what its sensors saw: model, observations, search, fit, evidence, verdict."""
