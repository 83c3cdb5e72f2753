"""Orbits as tables of positions, compared with the elements they were made from."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import pytest

import sunspin as ss
from sunspin.environment.earth import Instants, J2000_from_TEME, earth_from_J2000, rotate_vectors
from sunspin.environment.elements import parse_elements
from sunspin.environment.ephemeris import read_orbit
from sunspin.environment.orbit import in_orbit

VZLUSAT = """1 42790U 17036AB  17236.90928386  .00002510  00000-0  11640-3 0  9996
2 42790  97.4437 295.9456 0012835  41.8426 318.3788 15.20921507  9461"""
BEGIN = datetime(2017, 8, 24)
EPOCH = "2017-08-24T00:10:00Z"
T = np.linspace(0.0, 6000.0, 97)
"""Of telemetry: between the positions."""


def states(step: float, count: int, frame: str = "J2000") -> tuple[list[datetime], np.ndarray]:
    """Times and rows of six (km, km/s) by SGP4."""
    (elements,) = parse_elements(VZLUSAT, "case")
    t = step * np.arange(count)
    when = Instants.of(BEGIN.isoformat() + "Z", t)
    both = np.array(elements.states(when.jd, when.fraction)) / 1e3
    if frame != "TEME":
        both = rotate_vectors(J2000_from_TEME(when), both)
    if frame == "ITRF":
        both = rotate_vectors(earth_from_J2000(when), both)
    return [BEGIN + timedelta(seconds=float(s)) for s in t], np.concatenate(both, axis=1)


def oem(frame="EME2000", scale="UTC", step=60.0, count=130, ahead=0.0) -> str:
    times, rows = states(step, count, "J2000" if frame == "EME2000" else frame)
    lines = [
        f"{(time + timedelta(seconds=ahead)).isoformat()} {' '.join(f'{x:.9f}' for x in row)}"
        for time, row in zip(times, rows, strict=True)
    ]
    first, last = lines[0].split()[0], lines[-1].split()[0]
    return f"""CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2017-08-25T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = VZLUSAT-1
OBJECT_ID = 2017-036AB
CENTER_NAME = EARTH
REF_FRAME = {frame}
TIME_SYSTEM = {scale}
START_TIME = {first}
STOP_TIME = {last}
META_STOP
COMMENT made by a test
{chr(10).join(lines)}
"""


def off_m(ephemeris) -> float:
    """The largest distance (m) from SGP4 at the telemetry's times."""
    elements = parse_elements(VZLUSAT, "case")
    orbits = (in_orbit(each, EPOCH, T) for each in (elements, (ephemeris,)))
    known, found = (orbit.states(orbit.instants(T))[0] for orbit in orbits)
    return float(np.linalg.norm(found - known, axis=1).max())


@pytest.fixture
def put(tmp_path):
    def write(text: str, name: str = "orbit.txt"):
        (tmp_path / name).write_text(text, "utf-8")
        return tmp_path / name

    return write


@pytest.mark.parametrize(
    ("frame", "scale", "step", "ahead"),
    [("EME2000", "UTC", 60.0, 0.0), ("TEME", "TAI", 180.0, 37.0)],
)
def test_an_orbit_from_an_oem_is_that_of_its_elements_to_ten_metres(put, frame, scale, step, ahead):
    (ephemeris,) = read_orbit(put(oem(frame, scale, step, int(7800 / step), ahead)))
    assert (ephemeris.name, ephemeris.number) == ("VZLUSAT-1", "2017-036AB")
    assert off_m(ephemeris) < 10
    orbit = in_orbit((ephemeris,), EPOCH, T)
    assert orbit.shift_sigma_s == pytest.approx(0.3) and orbit.notes(T) == []
    assert 5600 < ephemeris.period_s < 5760 and orbit.at(T).lit.min() == 0


def test_an_oem_in_xml_by_another_library_is_read(put, tmp_path):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    io = ndm_io.NdmIo()
    io.to_file(io.from_path(put(oem(), "a.oem")), ndm_io.NDMFileFormats.XML, tmp_path / "a.xml")
    (ephemeris,) = read_orbit(tmp_path / "a.xml")
    assert ephemeris.name == "VZLUSAT-1" and off_m(ephemeris) < 1


def test_a_csv_ephemeris_must_state_its_frame(put):
    times, rows = states(60.0, 130, "ITRF")
    body = "\n".join(
        f"{time.isoformat()}Z,{x:.6f},{y:.6f},{z:.6f}"
        for time, (x, y, z, *_) in zip(times, rows, strict=True)
    )
    text = f"# frame: ITRF\ntime_utc,x_km,y_km,z_km\n{body}\n"
    assert off_m(read_orbit(put(text, "a.csv"))[0]) < 10
    words = "a.csv: the ephemeris does not say its frame; add a first line such as `# frame"
    with pytest.raises(ss.InputError, match=words):
        read_orbit(put(text.split("\n", 1)[1], "a.csv"))


def test_an_spk_gives_the_orbit_that_spice_reads(tmp_path):
    sp = pytest.importorskip("spiceypy")
    times, rows = states(60.0, 130)
    tai_tt = 37 + 32.184  # TDB is TT to 2 ms: 13 m
    et = np.array([(time - datetime(2000, 1, 1, 12)).total_seconds() for time in times]) + tai_tt
    handle = sp.spkopn(str(tmp_path / "a.bsp"), "test", 0)
    sp.spkw09(handle, -142790, 399, "J2000", et[0], et[-1], "test", 7, len(et), rows, et)
    sp.spkcls(handle)
    assert off_m(read_orbit(tmp_path / "a.bsp")[0]) < 15
    (tmp_path / "b.bsp").write_bytes((tmp_path / "a.bsp").read_bytes()[:1500])
    with pytest.raises(ss.InputError, match=r"b\.bsp: the SPK cannot be used"):
        read_orbit(tmp_path / "b.bsp")


def test_beyond_its_table_an_ephemeris_continues_on_an_ellipse(put):
    (ephemeris,) = read_orbit(put(oem()))
    known = in_orbit(parse_elements(VZLUSAT, "case"), EPOCH, T)
    when = known.instants(np.array([7140.0 + 200, -600.0 - 200]))  # 200 s beyond either end
    far = known.states(when)[0]
    assert np.linalg.norm(ephemeris.states(when.jd, when.fraction)[0] - far, axis=1).max() < 1000


WRONG = {
    "the ephemeris does not cover the telemetry .found 2017-08-24T00:00:00Z to 2017-08-24T00:29:00Z, but not": lambda: (
        oem(count=30)
    ),
    "a position is not one of an orbit about the Earth .found 6.*e\\+06 km": lambda: _scaled(oem()),
    "the frame of the ephemeris is not known .found TOD.": lambda: oem().replace("EME2000", "TOD"),
    "the time system of the ephemeris is not known .found MRT.": lambda: oem(scale="MRT"),
    "the positions of the OEM are not about the Earth .found MARS": lambda: oem().replace(
        "NAME = EARTH", "NAME = MARS"
    ),
    "the OEM lacks a key .found REF_FRAME.": lambda: oem().replace("REF_FRAME", "FRAME"),
    "the velocities are not those of the positions: .* m/s off in the median; check units and frame": lambda: (
        oem("ITRF").replace("REF_FRAME = ITRF", "REF_FRAME = GCRF").replace("EME2000", "GCRF")
    ),
    "the positions are 900 s apart, between which an orbit is known to .* m only": lambda: oem(
        step=900.0, count=30
    ),
    "the times of the ephemeris do not increase": lambda: oem().replace("T00:05:00 ", "T00:03:00 "),
    "the ephemeris has no 9 positions in a row": lambda: oem(count=5),
    "a coordinate of the ephemeris is no number": lambda: oem().replace(" -", " x", 1),
    "line 16: a line of an OEM has a time, three coordinates": lambda: oem().replace(
        "T00:02:00 ", "T00:02:00 1 "
    ),
}


def _scaled(text: str) -> str:
    """Positions in m where km are meant."""
    lines = [line.split() for line in text.splitlines()]
    for cells in lines:
        if len(cells) == 7 and cells[0][:2] == "20":
            cells[1:] = [str(1000 * float(x)) for x in cells[1:]]
    return "\n".join(map(" ".join, lines))


@pytest.mark.parametrize("text", WRONG)
def test_wrong_ephemerides_are_refused_in_one_sentence(put, text):
    with pytest.raises(ss.InputError, match=text):
        in_orbit(read_orbit(put(WRONG[text]())), EPOCH, T)
