"""What else may have moved the body: models with one entry changed, fitted from the motions of the model as stated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sunspin.estimation.model import Model
from sunspin.estimation.settings import AlternativeSettings
from sunspin.estimation.terms.torques import WORDS, ConstantTorque


def alternatives(stated: Model, s: AlternativeSettings) -> Iterator[Model]:
    """Yield the models that are tried beside the one as stated, each as likely before the data.

    A constant torque in the body, and one in space.
    """
    obs = stated.obs
    duration = float(np.ptp(obs.t_s))
    for frame, words in WORDS.items():
        torque = ConstantTorque.turning(
            frame, s.torque_turns_rad, duration, stated.body.inertia, obs.momentum
        )
        yield stated.plus(torque, f"a steady torque in {words}")
