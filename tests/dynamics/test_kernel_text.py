"""The generated text of the kernels, by its hash: a motion without torques has the kernels it had before torques came.

The hashes were taken from the state before a motion had directions beside the Sun's, and torques. A change of the kernels' text
on purpose brings new ones; every user's kernels are then compiled again.
"""

import hashlib

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.ensemble.compiled import source
from sunspin.dynamics.ensemble.cuda import cuda_source
from sunspin.estimate.scan.mask import reconstructible_mask
from vehicles import random_vehicle

BEFORE = {
    (0, "series", 0): "eff2b03601ee3ffb", (0, "series", 256): "25bc155a228411d8",
    (0, "split", 0): "43ddf5235674f200", (0, "split", 256): "2e3884eae459ef74",
    (1, "series", 0): "9b2a10d69c7220cd", (1, "series", 256): "df69d43689fa3081",
    (1, "split", 0): "ee88ccff70e35ea1", (1, "split", 256): "a1fa304f766f94a7",
    (2, "series", 0): "6662cd791b824133", (2, "series", 256): "a07fbba6b331d5c4",
    (2, "split", 0): "5ca007ba3457a1cc", (2, "split", 256): "f0de6ac02fb73375",
}  # fmt: skip

PHILAE_BEFORE = {
    "series": ("27f171b806fbefd4", "165dd374aea8b424"), "split": ("c81f9d1503e8e821", "727f28e9240dcaf5"),
}  # fmt: skip
"""On the processor and on a GPU, with the mask of its panels."""


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@pytest.mark.parametrize(("n_wheels", "method", "bins"), BEFORE)
def test_without_torques_the_text_is_that_of_before_for_any_number_of_wheels(n_wheels, method, bins):
    vehicle = random_vehicle(np.random.default_rng(100 + n_wheels), n_wheels)
    assert digest(source(k.structure_of(vehicle, None, bins, method))) == BEFORE[n_wheels, method, bins]


@pytest.mark.parametrize("method", PHILAE_BEFORE)
def test_without_torques_the_text_is_that_of_before_for_philae(method):
    vehicle = ss.load_case("philae").vehicle
    structure = k.structure_of(vehicle, reconstructible_mask(vehicle), 256, method)
    assert (digest(source(structure)), digest(cuda_source(structure))) == PHILAE_BEFORE[method]
