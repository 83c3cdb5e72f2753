"""Motions that panels cannot distinguish: mirror images and rotated copies of one motion.

If panels share an input, it is not known which of them is lit; if all lie in one plane, a mirror across it changes no reading. A
body and its Sun seen in such a mirror move by the same laws. The search finds one of these motions, and the others are made from
it; each is then fitted by itself, since inertia, wheels or other sensors may distinguish them after all.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimation.copies import Outline
from sunspin.estimation.model import Model, Track
from sunspin.estimation.settings import SearchSettings
from sunspin.estimation.terms.panels import Panels

FAMILIES = 6
"""Motions of which images are made, at most."""

OPPOSITE, SAME_SIGMAS = -0.9, 3.0
"""Largest cosine between the Suns of two motions that see it on opposite sides, and how far (sigmas) their rates may be apart."""


def images_of(model: Model) -> np.ndarray:
    """Return mirrors and rotations (m, 3, 3) of the body that change nothing the sensors of the Sun read, the identity first."""
    seeing = [term for term in model.obs.terms if term.of_sun]
    if len(seeing) != 1 or not isinstance(seeing[0], Panels):
        return np.eye(3)[None]
    return seeing[0].images()


def imaged(motions: Track, image: np.ndarray) -> Track:
    """Return motions as a mirror or rotation of the body (3, 3) shows them, as unfitted ones.

    Rates are axial vectors, and N is mirrored with the body.
    """
    side = np.sign(np.linalg.det(image))
    attitude = image @ motions.attitude @ np.diag([side, 1.0, 1.0])
    return Track(attitude, side * (motions.omega @ image.T), motions.u)


def with_images(motions: Track, model: Model, s: SearchSettings) -> Track:
    """Return the motions with all images of the best ones that are not images of each other."""
    images = images_of(model)
    if len(images) == 1 or not len(motions):
        return motions
    t_s, families, members = model.obs.t_s, [], []
    for k in range(len(motions)):
        one = motions.take(slice(k, k + 1))
        outline = Outline.of(one, t_s)
        if any(outline.copies(0, other, s.copies_rad, 0.0).any() for other in members):
            continue
        every = Track.joined([imaged(one, image) for image in images])
        families.append(every.take(slice(1, None)))
        members.append(Outline.of(every, t_s))
        if len(families) == FAMILIES:
            break
    unfitted = Track(motions.attitude, motions.omega, motions.u)
    return Track.joined([unfitted, *families])


def either_side(motions: Track) -> np.ndarray:
    """Return which motions (K) turn like the first one and see the Sun where it does, or on the opposite side all the time."""
    opposite = np.einsum("kni,ni->kn", motions.sun_B, motions.sun_B[0]).max(axis=1) < OPPOSITE
    sigma = np.sqrt(np.einsum("nii->n", motions.covariance[0, :, 3:, 3:]))
    off = np.linalg.norm(motions.omega - motions.omega[0], axis=-1)
    return (opposite & (off < SAME_SIGMAS * sigma).all(axis=1)) | (np.arange(len(motions)) == 0)
