"""Which law a vehicle's panels follow: the table ``[panel_response]`` of its file, and the response made of it."""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar

import numpy as np

from sunspin.base.errors import VehicleError, sentence
from sunspin.vehicle.part import Part, Vector, part
from sunspin.vehicle.response.cosine import Cosine
from sunspin.vehicle.response.grazing import Grazing
from sunspin.vehicle.response.joined import Input, Inputs, Joined, full_signal
from sunspin.vehicle.response.protocol import Law, PanelResponse
from sunspin.vehicle.response.tabled import Tabled
from sunspin.vehicle.response.tilted import Tilted
from sunspin.vehicle.response.wall import Wall


@part
class ResponseForm(Part):
    """The law: at most one of these, and gain times cosine without. `turned_B_rad`: the rotation vector by which the panels as a
    whole stand turned against the axes of the body, under any law; its sigma is in the facts."""

    grazing: Grazing | None = None
    wall: Wall | None = None
    tilted: Tilted | None = None
    turned_B_rad: Vector | None = None

    unsaid: ClassVar[tuple[str, ...]] = ("turned_B_rad",)

    def __post_init__(self) -> None:
        laws = {
            name: law
            for name, law in vars(self).items()
            if name != "turned_B_rad" and law is not None
        }
        if len(laws) > 1:
            given = ", ".join(laws)
            raise VehicleError(
                sentence("panel_response must be one law", got=given, do="keep one of them")
            )

    @property
    def law(self) -> Grazing | Wall | Tilted | None:
        """The law given."""
        return self.grazing or self.wall or self.tilted

    @property
    def panels(self) -> tuple[str, ...]:
        """Names of panels that the law speaks of."""
        return () if self.law is None else self.law.panels


Triples = tuple[tuple[float, ...], ...]


@lru_cache(maxsize=64)
def response_of(
    law: Law | None,
    names: tuple[str, ...],
    normals_B: Triples,
    gains: tuple[float, ...],
    inputs: tuple[Input, ...] = (),
) -> PanelResponse:
    """The response of panels with these names, normals and gains; of `inputs`, where panels share some."""
    normals, strength = np.array(normals_B).reshape(-1, 3), np.array(gains)
    normals.setflags(write=False)
    if inputs:
        full = np.array([full_signal(one, normals, strength) for one in inputs])
        return Joined(normals, full, Inputs(law, inputs, gains, tuple(full.tolist())), names)
    strength.setflags(write=False)
    return Cosine(normals, strength) if law is None else Tabled(normals, strength, law, names)
