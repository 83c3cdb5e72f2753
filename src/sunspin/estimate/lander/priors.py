"""Priors of a lander: its unknowns, the sigma of each, and the source of that sigma."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sunspin.base.errors import InputError
from sunspin.dynamics import batch
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.window import Window, with_unknowns
from sunspin.estimate.model import Unknown, inertia_sigma
from sunspin.estimate.settings import (
    BRIGHTNESS_FREE,
    BRIGHTNESS_KNOWN,
    FRICTION,
    INERTIA,
    LANDER_LARGEST_RATE,
    LOOSER_INERTIA,
    NOISE_STATED,
    NOISE_UNSTATED,
    TORQUE_TURNS_DEG,
    WHEEL_SPEED,
)
from sunspin.estimate.terms.powers import PanelPowers, panel_turns, tilt_unknowns
from sunspin.estimate.terms.torques import WORDS, ConstantTorque
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.gains import stated_sigmas
from sunspin.vehicle import Vehicle, Wheel
from sunspin.vehicle.response.panels import misalignment_sigma

KEYS = set(
    "max_rate_rad_s steady_torque inertia wheel_speed wheel_inertia friction gain noise scale "
    "time_s tilt tilt_common".split()
)
"""Priors that a caller may give."""

ASSUMED, STATED, GIVEN = "assumed", "vehicle file", "given"
"""Sources of a sigma."""


@dataclass
class Sources:
    """Choice of sigmas: those of the caller's `priors` first, then those of the vehicle file, then assumed ones.

    `in_words`: value and source of each sigma by its key, added when the sigma is read; of all wheels, if they differ.
    """

    priors: Mapping[str, Any]
    in_words: dict[str, str] = field(default_factory=dict)

    def sigma(self, key: str, stated: float | None, assumed: float, unit: str = "") -> float:
        """Return the sigma of the prior `key`, relative unless it has a unit; zero if the number is known.

        `stated`: sigma of the vehicle file, None if it states none; then it is `assumed`, unless the caller gives one.
        """
        value, source = (assumed, ASSUMED) if stated is None else (stated, STATED)
        if key in self.priors:
            value, source = self.priors[key], GIVEN
        require_not_negative(value, f"the prior sigma of {key} must be zero (known) or positive")
        words = self.in_words.get(key, "").split("; ")
        if (new := f"{value:g}{unit} ({source})") not in words:
            self.in_words[key] = "; ".join(filter(None, [*words, new]))
        return float(value)


def with_priors(
    assessment: Assessment,
    window: Window,
    priors: Mapping[str, Any] | None,
    wheel_mode: Any = "coast",
) -> tuple[LanderModel, dict[str, str]]:
    """Return the model of a lander with all its unknowns, and the size and source of each prior in words, by key.

    `priors` and `wheel_mode` as in :func:`sunspin.posterior`. The reference of the model is the first sample, at which wheels have
    their measured speeds.
    """
    vehicle = _with_measured_speeds(assessment, window.start_s)
    vehicle.require_inertia()
    unknown = sorted(set(priors or {}) - KEYS)
    if unknown:
        raise InputError(
            f"priors know {', '.join(sorted(KEYS))}",
            got=", ".join(map(str, unknown)),
            do="leave it out",
        )
    sources = Sources(priors or {})
    mode = wheel_mode if isinstance(wheel_mode, str) else tuple(wheel_mode)
    panels = _panels_with_unknowns(vehicle, window, sources)
    of_motion = (*_wheel_unknowns(vehicle, mode, sources), *_inertia_unknowns(vehicle, sources))
    limit = sources.priors.get("max_rate_rad_s")
    if limit is None:
        limit = vehicle.sensors.disturbance.max_rate_rad_s or LANDER_LARGEST_RATE
    if not (np.isfinite(limit) and limit > 0):
        raise InputError("max_rate_rad_s must be positive", got=limit)
    sources.in_words["rate"] = f"uniform in a ball of {limit:g} rad/s"
    # only in words here: `constant_torques` makes the models of a torque
    most_deg = largest_torque_deg(sources.priors)
    source = GIVEN if "steady_torque" in sources.priors else ASSUMED
    size = f"turns by up to {most_deg:g} deg" if most_deg else "none"
    sources.in_words["steady_torque"] = f"{size} ({source})"
    model = LanderModel(
        vehicle,
        with_unknowns(window.obs, panels),
        tuple(x for x in of_motion if x.sigma > 0),  # a known number is no unknown
        float(limit),
        mode,
    )
    if model.log_possible:
        share = np.exp(model.log_possible)
        sources.in_words["inertia"] += f", truncated to bodies that can exist ({share:.2g} of it)"
    return model, sources.in_words


def constant_torques(model: LanderModel, priors: Mapping[str, Any] | None) -> list[LanderModel]:
    """Return the alternative models with an unmodelled constant torque: one in body axes, and one in space.

    Its size is unknown by powers of ten: several angles are equally probable by which the torque alone would rotate the body over
    the samples. The largest one is the prior `steady_torque`: a larger one than usual spreads the angles, a smaller one leaves some
    out, and if it is zero there are no such models.
    """
    most_deg = largest_torque_deg(priors or {})
    if not most_deg:
        return []
    low, high, count = TORQUE_TURNS_DEG
    sizes = np.geomspace(low, max(high, most_deg), count)
    allowed = sizes[sizes <= most_deg * (1 + 1e-9)]
    angles = np.radians(allowed if len(allowed) else [most_deg])
    duration = float(np.ptp(model.obs.t_s))
    inertia = np.array(model.vehicle.require_inertia())
    still = np.zeros((len(model.obs), 3))
    models = []
    for frame in WORDS:
        torque = ConstantTorque.turning(frame, angles.tolist(), duration, inertia, still)
        unknowns, what = torque.unknowns(), f"a steady torque in {WORDS[frame]}"
        of_motion = (*model.of_motion, *unknowns)
        models.append(replace(model, of_motion=of_motion, frame=frame, what=what))
    return models


def largest_torque_deg(priors: Mapping[str, Any]) -> float:
    """Return the largest angle (deg) by which a constant torque alone may rotate the body over the samples: a prior."""
    most = priors.get("steady_torque", TORQUE_TURNS_DEG[1])
    require_not_negative(
        most,
        "steady_torque, the most that one may turn the body over the samples, must be zero or positive, in degrees",
    )
    return float(most)


def require_not_negative(value: Any, message: str) -> None:
    """Raise InputError with a message unless the value is a finite number that is not negative."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and np.isfinite(value) and value >= 0):
        raise InputError(message, got=value)


def _with_measured_speeds(assessment: Assessment, at_s: float) -> Vehicle:
    """Return the vehicle with the wheel speeds of the telemetry at a time (s from the epoch), if there are any.

    Between readings the speed is interpolated linearly; before the first and after the last it is that of the nearest. A wheel that
    was never read keeps its nominal speed.
    """
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    if "wheel_speed_rad_s" not in telemetry or not vehicle.wheels:
        return vehicle
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    read, wheels = telemetry["wheel_speed_rad_s"].values, []
    for k, wheel in enumerate(vehicle.wheels):
        known = np.flatnonzero(np.isfinite(read[:, k]))
        known = known[np.argsort(t_s[known], kind="stable")]
        speed = np.interp(at_s, t_s[known], read[known, k]) if len(known) else wheel.speed_rad_s
        wheels.append(replace(wheel, speed_rad_s=float(speed)))
    return replace(vehicle, wheels=tuple(wheels))


def _stated(vehicle: Vehicle, key: str, value: float) -> float | None:
    """Return the sigma that the vehicle file states for `key`, divided by the value of that key; None if it states none."""
    fact = vehicle.facts.get(key)
    if fact is None or fact.sigma is None or not value:
        return None
    return float(np.asarray(fact.sigma)) / value


def _panels_with_unknowns(vehicle: Vehicle, window: Window, sources: Sources) -> PanelPowers:
    """Return the panel term with its unknowns: log brightness (prior `scale`), log noise, log gains, and tilts of panels.

    An unknown with a sigma of zero is known and is left out. Throttled panels have a free factor in each sample instead of a scale.
    """
    panels = next(term for term in window.obs.terms if isinstance(term, PanelPowers))
    if vehicle.throttled:
        sources.in_words["scale"] = "free in each sample (throttled)"
        sigma_scale = 0.0
    else:
        assumed_scale = BRIGHTNESS_FREE if vehicle.gain_unit is None else BRIGHTNESS_KNOWN
        sigma_scale = sources.sigma("scale", None, assumed_scale)
    assumed_noise = NOISE_UNSTATED if vehicle.input_noise is None else NOISE_STATED
    sigma_noise = sources.sigma("noise", None, assumed_noise)
    sigma_gains = [
        sources.sigma("gain", None if np.isnan(stated) else float(stated), 0.0)
        for stated in stated_sigmas(vehicle)
    ]
    unknowns = (
        Unknown("log_scale", "scale", "1", float(np.log(panels.brightness)), sigma_scale),
        Unknown("log_noise", "noise", "1", 0.0, sigma_noise),
        *(
            Unknown(f"log_gain_{name}", "gain", "1", 0.0, sigma, j)
            for j, (name, sigma) in enumerate(zip(vehicle.input_names, sigma_gains, strict=True))
        ),
    )
    own = (*(x for x in unknowns if x.sigma > 0), *_tilt_unknowns(vehicle, sources))
    time_s = sources.sigma("time_s", None, 0.0, " s")
    if time_s and vehicle.throttled:
        what = "the posterior does not know errors of times if panels are throttled"
        raise InputError(what, got=f"time_s {time_s:g}", do="leave the prior time_s out")
    return replace(panels, own=own, turns=panel_turns(vehicle, own), time_s=time_s)


def _tilt_unknowns(vehicle: Vehicle, sources: Sources) -> tuple[Unknown, ...]:
    """Return the unknown misalignments of panels for which the vehicle file or the caller gives a sigma (rad).

    `tilt` is that of each panel by itself, `tilt_common` that of all panels together. InputError if panels share inputs or are
    throttled: their misalignments are not modelled.
    """
    for key in ("tilt", "tilt_common"):
        sigma = sources.priors.get(key, 0.0)
        require_not_negative(
            sigma, f"the prior sigma of {key} must be zero (known) or positive, in rad"
        )
    own, common = misalignment_sigma(vehicle)
    if "tilt" in sources.priors:
        own = np.full(len(own), float(sources.priors["tilt"]))
    common = float(sources.priors.get("tilt_common", common))
    for key, size in (("tilt", float(own.max(initial=0.0))), ("tilt_common", common)):
        source = GIVEN if key in sources.priors else STATED if size else ASSUMED
        sources.in_words[key] = f"{np.degrees(size):.3g} deg ({source})"
    if (vehicle.channels or vehicle.throttled) and (own.any() or common):
        what = "the posterior does not know turns of panels that share an input or are throttled"
        got = f"channel {vehicle.channels[0].name!r}" if vehicle.channels else "throttled = true"
        do = "take panels as drawn with --prior tilt=0 --prior tilt_common=0; sigmas of the rates then leave the turns out"
        raise InputError(what, got=got, do=do)
    return tilt_unknowns(vehicle, own, common)


def wheel_unknown(name: str, vehicle: Vehicle, wheel: Wheel) -> str:
    """Return the full name of a wheel's unknown: if there are several wheels, the name of the wheel is added."""
    return name if len(vehicle.wheels) == 1 else f"{name}_{wheel.name}"


def _wheel_unknowns(vehicle: Vehicle, mode: Any, sources: Sources) -> list[Unknown]:
    """Return four unknowns of each wheel: its speed (rad/s), and the logarithms of its inertia, Coulomb and viscous friction.

    `mode`: "coast", "hold" or "brake", or one for each wheel. A sigma of zero means that the number is known. A held speed is known
    unless the caller or the vehicle file gives a sigma. Friction is known unless the wheel coasts.
    """
    unknowns = []
    commands = batch.one_command(vehicle, mode)
    for i, (wheel, command) in enumerate(zip(vehicle.wheels, commands, strict=True)):
        at = f"wheel.{wheel.name}"
        speed = abs(wheel.speed_rad_s)
        fact = vehicle.facts.get(f"{at}.speed_rad_s")
        sigma_in_file = fact is not None and fact.sigma is not None
        if not speed and sigma_in_file and "wheel_speed" not in sources.priors:
            # a wheel at rest: a relative sigma would be zero, so the sigma of the file is taken in rad/s
            sigma = sources.sigma("wheel_speed", float(np.asarray(fact.sigma)), 0.0, " rad/s")
        else:
            stated = _stated(vehicle, f"{at}.speed_rad_s", speed)
            assumed = WHEEL_SPEED if command != "hold" else 0.0
            sigma = speed * sources.sigma("wheel_speed", stated, assumed)
        name = wheel_unknown("wheel_speed", vehicle, wheel)
        unknowns.append(Unknown(name, "wheel_speed", "rad/s", wheel.speed_rad_s, sigma, i))
        stated = _stated(vehicle, f"{at}.inertia_kg_m2", wheel.inertia_kg_m2)
        sigma = sources.sigma("wheel_inertia", stated, 0.0)
        name = wheel_unknown("log_wheel_inertia", vehicle, wheel)
        unknowns.append(Unknown(name, "wheel_inertia", "1", 0.0, sigma, i))
        for kind, key in (("coulomb", "coulomb_N_m"), ("viscous", "viscous_N_m_s")):
            value = getattr(wheel.friction, key)
            stated = _stated(vehicle, f"{at}.friction.{key}", value)
            acts = bool(value) and command == "coast"
            sigma = sources.sigma("friction", stated, FRICTION) if acts else 0.0
            name = wheel_unknown(f"log_{kind}", vehicle, wheel)
            unknowns.append(Unknown(name, kind, "1", 0.0, sigma, i))
    if vehicle.wheels:
        sources.in_words.setdefault("friction", "none acts")
    return unknowns


def _inertia_unknowns(vehicle: Vehicle, sources: Sources) -> list[Unknown]:
    """Return the six elements of the inertia (kg m2) as unknowns.

    Their sigmas are those of the vehicle file, if it states any. Otherwise one relative sigma is that of each moment, and times the
    mean moment that of each product of inertia, as in `rates`. With the probability `LOOSER_CHANCE` all sigmas are `LOOSER_INERTIA`
    times larger, because the inertia in the file is wrong.
    """
    tensor = np.array(vehicle.require_inertia())
    fact = vehicle.facts.get("body.inertia_kg_m2")
    if fact is not None and fact.sigma is not None and "inertia" not in sources.priors:
        sources.in_words["inertia"] = STATED
        sigma = np.broadcast_to(np.asarray(fact.sigma, dtype=np.float64), (3, 3))
    else:
        sigma = inertia_sigma(tensor, sources.sigma("inertia", None, INERTIA))
        sources.in_words["inertia"] += " of each moment, of the mean moment for each product"
    return [
        Unknown(
            f"inertia_{'xyz'[a]}{'xyz'[b]}",
            "inertia",
            "kg m2",
            tensor[a, b],
            float(sigma[a, b]),
            3 * a + b,
            shares=(1.0, LOOSER_INERTIA),
        )
        for a in range(3)
        for b in range(a, 3)
    ]
