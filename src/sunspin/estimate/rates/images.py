"""Motions that panels on shared inputs cannot tell apart: mirror images and turned copies of one motion.

Which panel of an input is lit is not told, so a mirror that exchanges its panels changes no reading (`PanelResponse.symmetries`); a
body and its Sun seen in that mirror move by the same laws. The search finds one of such motions and makes the others of it; each
is then fitted by itself, since inertia, wheels or other sensors may tell them apart after all.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.state import Observations, Track

FAMILIES = 6
"""Motions of which images are made, at most."""

SAME_RAD = 0.2
"""Directions from which a search starts that are nearer to an image of another are one."""

OPPOSITE, SAME_SIGMAS = -0.9, 3.0
"""Cosine between the Suns of two motions that see it on opposite sides, at most, and how far (sigmas) the rates of one motion may
be apart."""


def images_of(o: Observations) -> np.ndarray:
    """Mirrors and turns (m, 3, 3) of the body that change nothing the Sun's sensor reads, the first of them none at all."""
    return o.of_sun[0].images() if len(o.of_sun) == 1 else np.eye(3)[None]


def one_of_each(o: Observations, suns: np.ndarray) -> np.ndarray:
    """Of directions (n, 3) those that are no images of others, where nothing but the Sun tells an image from its motion."""
    images = images_of(o)
    if len(images) == 1 or o.of_state or o.of_pairs or o.momentum.any():
        return suns
    chosen: list[np.ndarray] = []
    for sun in suns:
        if all((images @ sun @ other).max() < np.cos(SAME_RAD) for other in chosen):
            chosen.append(sun)
    return np.array(chosen)


def imaged(track: Track, image: np.ndarray) -> Track:
    """Hypotheses as a mirror or a turn of the body (3, 3) shows them; rates are axial vectors, and N is mirrored with the body."""
    side = np.sign(np.linalg.det(image))
    return Track(image @ track.attitude @ np.diag([side, 1.0, 1.0]), side * (track.omega @ image.T))


def joined_images(track: Track, images: np.ndarray) -> Track:
    """All hypotheses in each of the images (m, 3, 3)."""
    each = [imaged(track, image) for image in images]
    return Track(
        np.concatenate([one.attitude for one in each]), np.concatenate([one.omega for one in each])
    )


def either_side(track: Track) -> np.ndarray:
    """Which modes (K) turn like the first and see the Sun where it does or on the opposite side, all the time."""
    opposite = np.einsum("kni,ni->kn", track.sun_B, track.sun_B[0]).max(axis=1) < OPPOSITE
    sigma = np.sqrt(np.einsum("nii->n", track.covariance[0, :, 3:, 3:]))
    same = (np.linalg.norm(track.omega - track.omega[0], axis=-1) < SAME_SIGMAS * sigma).all(axis=1)
    return (opposite & same) | (np.arange(len(same)) == 0)
