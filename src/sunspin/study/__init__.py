"""What the motion means: twins, the paper row by row."""
