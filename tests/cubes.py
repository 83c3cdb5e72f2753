"""The normals of a cube's faces by their names, in capitals and not."""

from __future__ import annotations

FACES = {
    "+X": [1, 0, 0],
    "-X": [-1, 0, 0],
    "+Y": [0, 1, 0],
    "-Y": [0, -1, 0],
    "+Z": [0, 0, 1],
    "-Z": [0, 0, -1],
}

SIDES = {name.lower(): normal for name, normal in FACES.items()}
