"""Motions that panels cannot distinguish: mirror images and rotated copies of one motion.

If panels share an input, it is not known which of them is lit; if all lie in one plane, a mirror across it changes no reading. A
body and its Sun seen in such a mirror move by the same laws. The search finds one of these motions, and the others are made from
it; each is then fitted by itself, since inertia, wheels or other sensors may distinguish them after all.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.carry import RATE
from sunspin.estimate.copies import Outline
from sunspin.estimate.model import Model, Track
from sunspin.estimate.settings import SearchSettings
from sunspin.estimate.terms.panels import Panels

FAMILIES = 6
"""Motions of which images are made, at most."""

OPPOSITE, SAME_SIGMAS = -0.9, 3.0
"""Largest cosine between the Suns of two motions that see it on opposite sides, and how far (sigmas) their rates may be apart."""


def images_of(model: Model) -> np.ndarray:
    """Return mirrors and rotations (m, 3, 3) of the body that change no reading of the Sun, the identity first."""
    of_sun = [term for term in model.obs.terms if term.of_sun]
    if len(of_sun) != 1 or not isinstance(of_sun[0], Panels):
        return np.eye(3)[None]
    return of_sun[0].images()


def imaged(motions: Track, image: np.ndarray) -> Track:
    """Return motions as a mirror or rotation of the body (3, 3) shows them, without cost and covariance.

    Rates are axial vectors, whose sign a mirror reverses. A mirrored attitude is a rotation only if an axis of N is mirrored too:
    x, which is across the Sun.
    """
    side = np.sign(np.linalg.det(image))
    attitude = image @ motions.attitude @ np.diag([side, 1.0, 1.0])
    return Track(attitude, side * (motions.omega @ image.T), motions.u)


def with_images(motions: Track, model: Model, s: SearchSettings) -> Track:
    """Return motions and all images of the first :data:`FAMILIES` of them that are not images of each other.

    `motions`: the best first. They come first in the result too.
    """
    images = images_of(model)
    if len(images) == 1 or not len(motions):
        return motions
    # A family is a motion with all its images. A further motion that is a copy of one of a family makes no new family.
    t_s, outlines, new = model.obs.t_s, [], []
    for k in range(len(motions)):
        motion = motions.take(slice(k, k + 1))
        outline = Outline.of(motion, t_s)
        # copies by their turns alone: without covariances nothing is in one valley, so the allowance in sigmas is zero
        if any(outline.copies(0, family, s.copies_rad, 0.0).any() for family in outlines):
            continue
        family = Track.joined([imaged(motion, image) for image in images])
        outlines.append(Outline.of(family, t_s))
        new.append(family.take(slice(1, None)))  # without the motion itself
        if len(new) == FAMILIES:
            break
    unfitted = Track(motions.attitude, motions.omega, motions.u)
    return Track.joined([unfitted, *new])


def either_side(motions: Track) -> np.ndarray:
    """Return which motions (K) are the first one, or turn like it and see the Sun on the opposite side all the time."""
    opposite = np.einsum("kni,ni->kn", motions.sun_B, motions.sun_B[0]).max(axis=1) < OPPOSITE
    sigma = np.sqrt(np.einsum("nii->n", motions.covariance[0, :, RATE, RATE]))
    off = np.linalg.norm(motions.omega - motions.omega[0], axis=-1)
    same_rate = (off < SAME_SIGMAS * sigma).all(axis=1)
    is_first = np.arange(len(motions)) == 0
    return is_first | (opposite & same_rate)
