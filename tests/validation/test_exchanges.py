"""Satellites with two panel columns exchanged: the simulator that draws them, and what `rates` says of some."""

import numpy as np
import pytest

from validation.exchanges import FACES, Satellite, equivalents, exchanges, run, satellite


def test_what_looks_the_same_in_the_simulator_is_a_mirror_that_no_wheel_shows():
    t = np.arange(3.0)
    readings = np.ones((3, 6))
    made = Satellite(
        ("+X", "+Y", "+Z", "-X", "-Y", "-Z"),
        FACES,
        np.ones(6),
        np.diag([1.0, 2.0, 2.5]),
        np.zeros((0, 3)),
        t,
        readings,
        np.zeros((3, 3)),
    )
    swapped = np.array([3, 1, 2, 0, 4, 5])
    (mirror,) = equivalents(made, swapped)
    np.testing.assert_allclose(mirror, np.diag([-1.0, 1.0, 1.0]), atol=1e-12)
    assert not equivalents(made._replace(momenta=np.array([[0.0, 0.0, 0.3]])), swapped)
    assert len(equivalents(made._replace(momenta=np.array([[0.3, 0.0, 0.0]])), swapped)) == 1
    assert not equivalents(made, np.array([1, 0, 2, 3, 4, 5]))


def test_satellites_have_four_to_nine_panels_and_two_exchanges_each():
    for i in (7, 42):
        made = satellite(0, i)
        first, second = exchanges(0, i, made.normals)
        assert 4 <= len(made.names) <= 9 and first != second and len(made.momenta) in (0, 1, 2)
        np.testing.assert_array_equal(
            made.readings, satellite(0, i).readings
        )  # a case is its number


@pytest.mark.long
@pytest.mark.parametrize(("i", "fits"), [(0, False), (10, True)])
@pytest.mark.evidence(
    "rates", "modelled", "columns of two panels exchanged, on satellites with wings and wheels"
)
def test_exchanged_columns_are_named_and_the_right_file_is_not_accused(i, fits):
    """Also where the file fits as it is written, as strong torques and gains that are off explain nearly everything."""
    rows = [run((0, i, which)) for which in (-1, 0)]
    assert rows[0]["outcome"] == "decided" and rows[0]["pull"] < 5
    pair = " and ".join(rows[1]["pair"])
    assert (
        rows[1]["outcome"] == "named rightly" and rows[1]["fits"] == fits and not rows[1]["decided"]
    )
    assert rows[1]["named"] == [f"the columns of panels {pair} exchanged"]
