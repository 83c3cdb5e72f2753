"""What the motions of a posterior are compared with beside panels: a file for each kind of reading, and the unknowns."""
