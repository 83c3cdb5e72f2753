"""How a vehicle's panels stand beside their drawing: the table ``[panel_response]`` of its file, and the response made of it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sunspin.vehicle.part import Name, Part, Vector, part
from sunspin.vehicle.response.cosine import Cosine
from sunspin.vehicle.response.joined import Input, Joined
from sunspin.vehicle.response.protocol import PanelResponse


@part
class Tilted(Part):
    """The normal of `panel` is turned by the rotation vector `turn_B_rad`; its sigma is in the facts."""

    panel: Name
    turn_B_rad: Vector


@part
class ResponseForm(Part):
    """A panel that stands turned, and the rotation vector `turned_B_rad` by which the panels as a whole stand turned against the
    axes of the body; its sigma is in the facts."""

    tilted: Tilted | None = None
    turned_B_rad: Vector | None = None


Triples = tuple[tuple[float, ...], ...]


@lru_cache(maxsize=64)
def response_of(
    normals_B: Triples,
    gains: tuple[float, ...],
    inputs: tuple[Input, ...] = (),
) -> PanelResponse:
    """The response of panels with these normals and gains; of `inputs`, where panels share some."""
    normals, strength = np.array(normals_B).reshape(-1, 3), np.array(gains)
    normals.setflags(write=False)
    strength.setflags(write=False)
    return Joined(normals, strength, inputs) if inputs else Cosine(normals, strength)
