"""A search by the magnetic field, if it is known in space and too few samples see the Sun; and how a fit then begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.estimate.chain import fit
from sunspin.estimate.copies import distinct
from sunspin.estimate.model import SUN_N, Model, Noise, States, Track
from sunspin.estimate.settings import SearchSettings
from sunspin.estimate.terms.field import KnownField
from sunspin.estimate.terms.torques import GravityTorque
from sunspin.solve.rotations import rotate_attitude

FEWEST_SUNS = 4
"""Samples that show the Sun; with fewer, a search begins with the field where it is known."""

FIELD_TURNS, SUN_TURNS = 8, 6
"""Turns about the field, and about the Sun if a torque shows it, from which a fit begins."""

FIT_STEPS = 12
"""Steps of the fits from these turns, of which few are left."""


def models_to_search(nominal: Model, noise: Noise) -> list[Model]:
    """Return the models that are searched: by the field's directions in place of the Sun's if hardly any sample shows the Sun."""
    known = leading_field(nominal)
    if known is None:
        return nominal.for_search(noise)
    loose = nominal.for_search(noise)[0]
    pairs = zip(nominal.obs.terms, loose.obs.terms, strict=True)
    others = (of_search for term, of_search in pairs if not term.of_sun and term is not known)
    return [replace(loose, obs=replace(loose.obs, terms=(known.as_sun_directions(), *others)))]


def leading_field(nominal: Model) -> KnownField | None:
    """Return the known field whose directions the search uses in place of the Sun's; None if it uses the Sun's."""
    known = [term for term in nominal.obs.terms if isinstance(term, KnownField)]
    return known[0] if known and nominal.obs.sees_sun.sum() < FEWEST_SUNS else None


def to_nominal_axes(nominal: Model, loose: Model, motions: Track, s: SearchSettings) -> Track:
    """Return motions of a search in the axes N of the nominal model; `loose`: the model that was searched.

    A search by the field finds motions in axes whose z follows the field, and leaves the turn about it open. They are fitted with
    the field as it is known in N, from several such turns; the field's turning in space leaves few of them. A search by the Sun
    leaves the turn about the Sun open: if nothing but the gravity gradient shows it, several are tried.
    """
    known = leading_field(nominal)
    if known is not None:
        turns, frames = FIELD_TURNS, known.field_axes()
        plain = nominal.for_search(loose.noise)[0]
        terms = tuple(
            known.without_errors() if term is known else of_search
            for term, of_search in zip(nominal.obs.terms, plain.obs.terms, strict=True)
        )
        model = replace(plain, obs=replace(plain.obs, terms=terms))
    elif any(isinstance(term, GravityTorque) for term in nominal.obs.terms):
        turns, frames, model = SUN_TURNS, np.eye(3), loose
    else:
        return motions
    tracks = []
    for angle in 2 * np.pi / turns * np.arange(turns):
        attitude = motions.attitude @ rotate_attitude(np.eye(3), -angle * SUN_N) @ frames
        omega = motions.omega
        if known is not None:
            omega = omega + np.einsum("knij,nj->kni", attitude, known.axes_rate_N())
        tracks.append(Track.free(attitude, omega))
    fitted = fit(model, Track.joined(tracks), FIT_STEPS).motions
    if known is None:  # all turns fit the Sun alike: the fit with its unknowns decides
        return fitted
    return fitted.take(distinct(fitted, model.obs.t_s, s))


def prepare_fit(model: Model, motions: Track) -> Track:
    """Return motions of a search with the attitudes and unknowns from which a fit of the model begins."""
    attitude, u = motions.attitude, np.zeros((len(motions), len(model.unknowns)))
    about_sun = False
    if len(motions):
        # terms that show the turn about the Sun come first: the others begin from the attitudes that they determine
        for term, own in sorted(model.terms_with_slices, key=lambda pair: not pair[0].about_sun):
            attitude, u[:, own] = term.first_guess(States(attitude, motions.omega), about_sun)
            about_sun |= term.about_sun
    return Track(attitude, motions.omega, u)
