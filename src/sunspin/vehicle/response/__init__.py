"""How panels see light: `protocol.py` says what is asked, `cosine.py` answers for panels each on an input of its own, `joined.py`
where panels share inputs; `choice.py` makes the one or the other of a vehicle's file."""
