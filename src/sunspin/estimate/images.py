"""Symmetric solutions: mirror images and rotated copies of a motion, which panels cannot distinguish from it.

If panels share an input, the readings do not show which of them is lit; if all lie in one plane, a mirror across it changes no
reading. A body and its Sun in such a mirror obey the same equations of motion. The search finds one of these motions, and the
others are computed from it. Each is then fitted by itself, since inertia, wheels or other sensors may distinguish them after all.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.carry import RATE
from sunspin.estimate.copies import Outline
from sunspin.estimate.model import Model, Track
from sunspin.estimate.settings import SearchSettings
from sunspin.estimate.terms.panels import Panels

MOST_FAMILIES = 6
"""Motions whose images are added, at most."""

OPPOSITE_COSINE, SAME_SIGMAS = -0.9, 3.0
"""Two motions see the Sun on opposite sides if the cosine between its directions is below the first, and have the same rate if
their rates differ by less than the second, in sigmas."""


def images_of(model: Model) -> np.ndarray:
    """Return the mirrors and rotations (m, 3, 3) of body axes that change no reading of the Sun, the identity first."""
    of_sun = [term for term in model.obs.terms if term.of_sun]
    if len(of_sun) != 1 or not isinstance(of_sun[0], Panels):
        return np.eye(3)[None]
    return of_sun[0].images()


def imaged(motions: Track, image: np.ndarray) -> Track:
    """Return motions after a mirror or rotation `image` (3, 3) of body axes, without cost and covariance.

    Rates are axial vectors: a mirror also reverses their sign. It mirrors the x axis of N too, to make the attitude a rotation
    again.
    """
    sign = np.sign(np.linalg.det(image))  # -1 for a mirror
    attitude = image @ motions.attitude @ np.diag([sign, 1.0, 1.0])
    return Track(attitude, sign * (motions.omega @ image.T), motions.u)


def with_images(motions: Track, model: Model, s: SearchSettings) -> Track:
    """Return motions, and after them the images of the best ones: all mirrored and rotated copies with the same panel readings.

    `motions`: the best first. A motion and its images are a family; a motion that is a copy of a member of an earlier family begins
    none. Images are made for the first :data:`MOST_FAMILIES` families. If the panels have no symmetry, the motions are returned as
    they are; else nothing in the result has cost or covariance, as each is fitted again.
    """
    images = images_of(model)  # the identity first
    if len(images) == 1 or not len(motions):
        return motions
    t_s, outlines_of_families, added = model.obs.t_s, [], []
    for k in range(len(motions)):
        motion = motions.take(slice(k, k + 1))
        outline = Outline.of(motion, t_s)
        # compared by their rotations alone (0 sigmas): images have no covariance, without which rates cannot be compared
        if any(outline.copies(0, o, s.copies_rad, 0.0).any() for o in outlines_of_families):
            continue
        family = Track.joined([imaged(motion, image) for image in images])
        outlines_of_families.append(Outline.of(family, t_s))
        added.append(family.take(slice(1, None)))  # without the motion itself
        if len(added) == MOST_FAMILIES:
            break
    unfitted = Track(motions.attitude, motions.omega, motions.u)
    return Track.joined([unfitted, *added])


def either_side(motions: Track) -> np.ndarray:
    """Return which motions (K) are the first one, or have its rates and see the Sun on the opposite side at all samples."""
    opposite = (
        np.einsum("kni,ni->kn", motions.sun_B, motions.sun_B[0]).max(axis=1) < OPPOSITE_COSINE
    )
    # (n) one sigma of the rate vector in rad/s: the root of the trace of its covariance
    sigma = np.sqrt(np.einsum("nii->n", motions.covariance[0, :, RATE, RATE]))
    off = np.linalg.norm(motions.omega - motions.omega[0], axis=-1)
    same_rate = (off < SAME_SIGMAS * sigma).all(axis=1)
    is_first = np.arange(len(motions)) == 0
    return is_first | (opposite & same_rate)
