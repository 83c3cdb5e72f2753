"""The words of the check of elements against telemetry."""

import numpy as np
import pytest

from sunspin.estimate.orbit.check import OrbitCheck, Verdict
from sunspin.output.check.orbit import _lines

SUMMARY = {"name": "a cube", "satellite": 90001, "notes": []}


@pytest.mark.parametrize(
    ("angle_deg", "samples", "turned_axes", "warned"),
    [
        (18.4, 12, "", True),
        (4.0, 12, "", False),
        (18.4, 12, "OTHER AXES of the magnetometer fit", False),  # these words say more
        (18.4, 30, "", False),  # the verdict itself is of the angle
        (np.nan, 0, "", False),
    ],
)
def test_a_large_angle_between_field_and_sun_in_few_samples_is_a_warning(
    angle_deg, samples, turned_axes, warned
):
    check = OrbitCheck(
        0.0,
        10.0,
        Verdict.FITS,
        samples={"field": 60, "field and Sun": samples},
        strength_residual_T=2e-7,
        angle_residual_rad=np.radians(angle_deg),
        turned_axes=turned_axes,
    )
    words = "\n".join(_lines(SUMMARY, check))
    assert ("FIELD AND SUN DISAGREE" in words) is warned
    assert ("too few samples to judge" in words) is (0 < samples < 20)
