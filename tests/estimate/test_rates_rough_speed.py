"""The rough speed that each pass reports while it is computed: two digits, and nothing that sounds decided."""

import re

import numpy as np

import sunspin as ss
from sunspin.estimate.rates.rough import roughly
from sunspin.estimate.rates.state import Observations, Track
from validation.passes import FACES, observe, spin


def track(speeds_deg_s, log_weight):
    omega = np.radians(speeds_deg_s)[:, None, None] * np.ones((1, 3, 1)) * np.array([0.0, 0.6, 0.8])
    return Track(
        np.broadcast_to(np.eye(3), (*omega.shape, 3)), omega, log_weight=np.array(log_weight)
    )


def test_rough_speeds_of_the_likeliest_solutions_have_two_digits():
    o = Observations(np.array([70.0, 80.0, 90.0]), np.zeros((3, 3)), ())
    said = roughly(o, track([3.637, 3.641, 123.4, 0.5], [0.0, -0.1, 1.0, -9.0]))
    assert said == "          70 s    3 samples  rough, not weighed yet: 120 or 3.6 deg/s"
    assert roughly(o, track([1.0, 2.0, 3.0, 4.0], np.zeros(4))).endswith(
        ": 1 or 2 or 3 or others deg/s"
    )


def test_each_pass_reports_its_rough_speed_once_before_it_is_finished(capsys):
    t = np.concatenate([np.arange(0.0, 200.0, 20.0) + start for start in (0.0, 3000.0)])
    each_pass = [spin(np.radians([1.0, -0.5, 0.8]), part) for part in np.split(t, 2)]
    omega, attitude = (np.concatenate(parts) for parts in zip(*each_pass, strict=True))
    made = observe(FACES, omega, attitude, t, 0.01, np.random.default_rng(3))
    setting = {"max_rate_rad_s": 0.03, "acceleration_noise": 1e-5}
    quiet = ss.rates(made.vehicle, made.telemetry, **setting)
    assert not capsys.readouterr().err
    told = ss.rates(made.vehicle, made.telemetry, progress=True, **setting)
    assert told.identical(quiet)
    shown = capsys.readouterr().err.replace("\r", "\n")
    lines = re.findall(r"^ *(\d+) s .*rough, not weighed yet: (\S+)", shown, re.MULTILINE)
    assert [line[0] for line in lines] == ["0", "3000"]
    assert all(abs(float(speed) - 1.375) < 0.1 for _, speed in lines)
