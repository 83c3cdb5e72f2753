"""Torques from outside on a body, each in a file of its own and with a line in `TORQUES`."""

from __future__ import annotations

from collections.abc import Sequence

from sunspin.base.errors import MotionError
from sunspin.dynamics.torques.acting import NOTHING, Acting, needed_around
from sunspin.dynamics.torques.gravity_gradient import GravityGradient
from sunspin.dynamics.torques.steady import Steady
from sunspin.environment import Environment

__all__ = ["NOTHING", "TORQUES", "Acting", "Steady", "acting"]

TORQUES = {torque.name: torque for torque in (GravityGradient(),)}
"""What may be named as a torque."""


def acting(
    torques: Sequence[str | Steady], environment: Environment | None, t_s: float = 0.0
) -> Acting:
    """The torques, by name or steady ones as they are, in their environment, for a motion that begins at `t_s`.

    `MotionError` for a name that is none, and for a torque that needs what the environment does not give.
    """
    if isinstance(torques, str):
        raise MotionError("torques must be a list", got=torques, do=f"write [{torques!r}]")
    known = tuple(torque if isinstance(torque, Steady) else _named(torque) for torque in torques)
    here = None if environment is None else environment.at(t_s)
    for torque in known:
        if needed_around([torque]) and here is None:
            do = "give one, such as sunspin.environment.circular(...)"
            raise MotionError(f"the torque {torque.name!r} needs an environment", do=do)
        for name in needed_around([torque]):
            if getattr(here, f"{name}_N") is None:
                raise MotionError(
                    f"the torque {torque.name!r} needs the {name}, which the environment does not know"
                )
    return Acting(known, environment, float(t_s))


def _named(name: str) -> GravityGradient:
    if not isinstance(name, str) or name not in TORQUES:
        raise MotionError("no such torque", got=name, do=f"choose from {', '.join(TORQUES)}")
    return TORQUES[name]
