"""What tests and campaigns share: simulated cases with a known truth, vehicles, files, a browser, the documents' code blocks.

A simulated case is synthetic telemetry of a motion that is known. A module is a subject; import from it by name, as in
``from tests.support.simulate import simulated_cube``.
"""
