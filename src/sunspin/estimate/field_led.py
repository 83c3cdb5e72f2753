"""A search by the magnetic field, for a pass in which too few samples see the Sun; and the start of a fit after any search.

A search works in axes whose z follows a direction in space: mostly the Sun (axes N), else the field if it is known in space. That
direction leaves the angle about it open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.estimate.chain import fit
from sunspin.estimate.copies import distinct
from sunspin.estimate.model import SUN_N, Model, Noise, States, Track
from sunspin.estimate.settings import FIELD_TURN, SearchSettings
from sunspin.estimate.terms.field import KnownField
from sunspin.estimate.terms.torques import GravityTorque
from sunspin.solve.rotations import rotate_attitude

FEWEST_SUNS = 4
"""If fewer samples show the Sun, a search uses the field, where it is known."""

FIELD_TURNS, SUN_TURNS = 8, 6
"""Number of evenly spaced angles about the field, or about the Sun, from which motions are fitted after the search."""

FIT_STEPS = 12
"""Steps of these fits. Their results start further fits."""

COARSE_STARTS, COARSE_RAD = 5, 1.0
"""Motions of a search that are fitted with coarse errors of a known field first, and these errors, as a part of the field."""


def models_to_search(nominal: Model, noise: Noise) -> list[Model]:
    """Return the models that a search uses: without unknowns, under random torques of the strength `noise`.

    There are several if readings may mean several things (`Model.for_search`). If hardly any sample shows the Sun, it is one model
    in which the directions of the field take the place of the Sun's.
    """
    models, field = nominal.for_search(noise), leading_field(nominal)
    if field is None:
        return models
    pairs = zip(nominal.obs.terms, models[0].obs.terms, strict=True)
    others = (in_search for term, in_search in pairs if not term.of_sun and term is not field)
    obs = replace(models[0].obs, terms=(field.as_sun_directions(), *others))
    return [replace(models[0], obs=obs)]


def leading_field(nominal: Model) -> KnownField | None:
    """Return the known field whose directions a search uses in place of the Sun's; None if it uses the Sun's."""
    return nominal.obs.of_kind(KnownField) if nominal.obs.sees_sun.sum() < FEWEST_SUNS else None


def sunlit_window(nominal: Model, s: SearchSettings) -> slice | None:
    """Return the longest run of samples that see the Sun, if the known field turns far in space while none does; else None.

    A search by the Sun compares each reading of the field with the one before. It does not know the angle about the Sun, and so not
    how the field turns in space: that counts as noise. In a long night it adds up. A spinner at 0.28 deg/s was found at 0.38 deg/s
    in an eclipse of 35 min, and decided. So a search begins within this window.
    """
    sees_sun, t_s = nominal.obs.sees_sun, nominal.obs.t_s
    if nominal.obs.of_kind(KnownField) is None or leading_field(nominal) is not None:
        return None
    sunlit = np.flatnonzero(sees_sun)
    # the times from one sunlit sample to the next, and from the ends of the pass
    ends = np.concatenate([t_s[:1], t_s[sunlit], t_s[-1:]])
    if np.diff(ends).max() * FIELD_TURN < s.basin_rad:
        return None
    runs = np.split(sunlit, np.flatnonzero(np.diff(sunlit) > 1) + 1)
    longest = max(runs, key=len)
    return slice(int(longest[0]), int(longest[-1]) + 1) if len(longest) >= FEWEST_SUNS else None


def with_known_field(nominal: Model, searched: Model) -> Model:
    """Return a model of a search in which the field is known in N; its errors that all samples have in common count as noise."""
    pairs = zip(nominal.obs.terms, searched.obs.terms, strict=True)
    terms = (
        term.without_errors() if isinstance(term, KnownField) else in_search
        for term, in_search in pairs
    )
    return replace(searched, obs=replace(searched.obs, terms=tuple(terms)))


def to_nominal_axes(nominal: Model, searched: Model, motions: Track, s: SearchSettings) -> Track:
    """Return the motions of a search in the axes N of the nominal model, fitted with the angle that the search left open.

    `searched`: the model that was searched, one of :func:`models_to_search`. After a search by the field, motions are converted
    from axes that follow the field to N, and each is fitted from `FIELD_TURNS` angles about the field. The field is known in N and
    changes its direction there, so that only a few of these fit; the others, and copies, are left out. After a search by the Sun,
    motions are in N already. If the torque of the gravity gradient acts, which depends on the angle about the Sun, each is fitted
    from `SUN_TURNS` angles, and all fits are returned. Else the motions are returned unchanged: if any sensor measures that angle,
    it gives it later (:func:`prepare_fit`).
    """
    field = leading_field(nominal)
    if field is not None:
        # number of angles; rotation (n, 3, 3) from N to axes that follow the field; model of the fits
        angle_count, from_N = FIELD_TURNS, field.field_axes()
        model = with_known_field(nominal, nominal.for_search(searched.noise)[0])
    elif nominal.obs.of_kind(GravityTorque) is not None:
        angle_count, from_N, model = SUN_TURNS, np.eye(3), searched
    else:
        return motions
    tracks = []
    for angle in 2 * np.pi / angle_count * np.arange(angle_count):
        about_z = rotate_attitude(np.eye(3), -angle * SUN_N)  # z: the field or the Sun
        attitude, omega = motions.attitude @ about_z @ from_N, motions.omega
        if field is not None:
            # from rates relative to the axes that follow the field to rates in space
            omega = omega + np.einsum("knij,nj->kni", attitude, field.axes_rate_N())
        tracks.append(Track.unfitted(attitude, omega))
    fitted = fit(model, Track.joined(tracks), FIT_STEPS).motions
    if field is None:  # the Sun fits every angle alike: the fit with all unknowns decides later
        return fitted
    return fitted.take(distinct(fitted, model.obs.t_s, s))


def prepare_fit(model: Model, motions: Track) -> Track:
    """Return motions of a search with the attitudes and unknowns from which a fit of the model begins.

    Terms guess what a search leaves open or takes for something else, such as the angle about the Sun or the light of the Earth.
    """
    attitude, u = motions.attitude, np.zeros((len(motions), len(model.unknowns)))
    sun_angle_known = False
    if len(motions):
        # terms that show the angle about the Sun come first: the others begin from the attitudes that they determine
        for term, own in sorted(model.terms_with_slices, key=lambda pair: not pair[0].about_sun):
            attitude, u[:, own] = term.first_guess(States(attitude, motions.omega), sun_angle_known)
            sun_angle_known |= term.about_sun
    return Track(attitude, motions.omega, u)


def with_coarse_field_fits(model: Model, motions: Track) -> Track:
    """Return K motions, and after them the first `COARSE_STARTS` fitted with errors of a known field of `COARSE_RAD`.

    A search by the Sun compares the field at neighbouring samples alone, so its motion may be off by radians about the Sun at the
    ends of a pass. A fit that begins there takes the field at some samples for outliers, and twists the motion by a revolution
    between them. With coarse errors there is no outlier. Without these fits the true motion of a spinner at 0.38 deg/s cost 187 in
    place of 31, and one that was a revolution in 10 s faster was decided. The motions are returned unchanged if no field is known.
    """
    field = model.obs.of_kind(KnownField)
    if field is None or not len(motions):
        return motions
    loosened = field.loosened(np.full(len(model.obs), COARSE_RAD), 0.0)
    coarse = replace(model, obs=model.obs.replacing(field, loosened))
    fitted = fit(coarse, motions.take(slice(COARSE_STARTS)), FIT_STEPS).motions
    return Track.joined([motions, Track(fitted.attitude, fitted.omega, fitted.u)])
