"""How panels see light. `protocol.py` says what is asked of a law; `cosine.py` answers in closed form, `tabled.py` for any other.

Another law is a file with a :class:`~sunspin.vehicle.part.Part` that has `panels` (names that it speaks of) and `share`, as in
`grazing.py`, and a line in `choice.py`.
"""
