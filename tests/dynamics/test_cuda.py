"""The kernels on a GPU: by numba's simulator, by compilation alone, and, where there is one, by a GPU."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cuda_cases
import sunspin as ss
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.ensemble import compiled, cuda
from sunspin.estimate.scan.mask import reconstructible_mask
from sunspin.estimate.scan.rows import EmdRows, Start, TrackRows

HAS_NUMBA_CUDA = importlib.util.find_spec("numba_cuda") is not None
needs_numba_cuda = pytest.mark.skipif(
    not HAS_NUMBA_CUDA, reason='numba-cuda is not installed (pip install "sunspin[gpu]")'
)
PHILAE = ss.load_vehicle("philae")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Results of all cases by the simulator, which has to be chosen before numba is imported."""
    path = tmp_path_factory.mktemp("cuda") / "results.npz"
    program = Path(cuda_cases.__file__)
    done = subprocess.run(
        [sys.executable, "-W", "error", str(program), str(path)],
        env=os.environ | {"NUMBA_ENABLE_CUDASIM": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    with np.load(path) as found:
        return dict(found)


def assert_agrees(name, found):
    """Directions to 1e-6 where 1e-8 was asked for, distributions to 2e-3 in EMD, and the plan to the step."""
    expected = cuda_cases.run_case(name, "cpu")
    assert np.array_equal(found["steps"], expected.steps)
    assert np.array_equal(found["outcome"], expected.outcome)
    if expected.hist.size:
        seen = expected.hist.sum(axis=1)
        assert np.all(seen > 1.0)
        assert np.abs(found["hist"].sum(axis=1) / seen - 1).max() < 1e-3
        emd = (
            np.abs(np.cumsum(found["hist"] - expected.hist, axis=1)).sum(axis=1)
            / seen
            / expected.hist.shape[1]
        )
        assert emd.max() < 2e-3
        assert np.abs(found["evenness"] - expected.evenness).max() < 1e-3
    elif not expected.outcome.any():
        assert found["track"].shape == expected.track.shape
        assert np.abs(found["track"] - expected.track).max() < 1e-6


@pytest.mark.evidence("scan", "verified", "the GPU's text in numba's simulator")
@needs_numba_cuda
@pytest.mark.parametrize("name", cuda_cases.CASES)
def test_the_simulator_agrees_with_the_processor(name, simulated):
    assert_agrees(
        name,
        {
            key.split("/")[1]: value
            for key, value in simulated.items()
            if key.startswith(f"{name}/")
        },
    )


@pytest.mark.evidence("scan", "verified", "the same motions on the processor (on an NVIDIA GPU)")
@pytest.mark.parametrize("name", cuda_cases.CASES)
def test_a_gpu_agrees_with_the_processor(name):
    try:
        k.require_device("cuda")
    except ss.InputError as error:
        pytest.skip(str(error))
    assert_agrees(name, vars(cuda_cases.run_case(name, "cuda")))


@pytest.mark.evidence(
    "posterior", "verified", "its likelihoods by the GPU's text in numba's simulator"
)
@needs_numba_cuda
def test_a_posterior_has_the_same_likelihoods_by_the_simulator(simulated):
    found, expected = simulated["log_likelihoods"], cuda_cases.log_likelihoods("cpu")
    assert (
        np.isfinite(expected).all() and abs(expected[0] - expected[1]) > 1
    )  # control: not any motion
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)


def test_a_posterior_on_a_device_that_is_not_there_is_refused(tmp_path):
    """Before the search, and nothing is written."""
    try:
        k.require_device("cuda")
        pytest.skip("this machine has an NVIDIA GPU")
    except ss.InputError as error:
        expected = str(error)
    case = ss.load_case("philae")
    with pytest.raises(ss.InputError) as caught:
        ss.posterior(case.vehicle, case.telemetry, device="cuda", store=tmp_path / "rows")
    assert str(caught.value) == expected and not (tmp_path / "rows").exists()


def test_the_wheel_of_the_cases_stops_on_the_way():
    vehicle, rows, times, _ = cuda_cases.CASES["a wheel that stops"]
    for omega, sun, speed in zip(rows.omega_B, rows.sun_B, rows.wheel_speed_rad_s, strict=True):
        run = ss.propagate(vehicle, omega, sun, speed, [0.0, *times])
        assert "stops" in " ".join(run["event_what"].values)


@needs_numba_cuda
@pytest.mark.parametrize("method", ["series", "split"])
def test_the_kernels_compile_for_a_gpu_without_one(method, monkeypatch):
    """To PTX for compute capability 9.0. A series of low order: the length of its text is the time that this takes."""
    monkeypatch.setattr("sunspin.dynamics.ensemble.series_lanes.ORDER", 3)
    assert_compiles(k.structure_of(PHILAE, cuda_cases.PANELS, 8, method), monkeypatch)


@needs_numba_cuda
@pytest.mark.slow
@pytest.mark.parametrize("bins", [0, 256])
@pytest.mark.parametrize("method", ["series", "split"])
def test_the_kernels_of_the_scan_compile_for_a_gpu_without_one(method, bins, monkeypatch):
    assert_compiles(k.structure_of(PHILAE, reconstructible_mask(PHILAE), bins, method), monkeypatch)


def assert_compiles(structure, monkeypatch):
    import numba
    from numba.cuda import compile_ptx, dispatcher
    from numba.cuda.cudadrv import nvvm

    if not nvvm.is_available():
        pytest.skip("NVVM is not installed (package nvidia-cuda-nvcc-cu12, or a CUDA toolkit)")
    # functions called by the kernel are compiled for the GPU at hand, whatever the kernel is compiled for
    monkeypatch.setattr(
        dispatcher, "get_current_device", lambda: SimpleNamespace(compute_capability=(9, 0))
    )
    real, single, whole = numba.float64, numba.float32, numba.int64
    signature = (
        real[:, ::1],
        whole[::1],
        whole[::1],
        real[:, :, ::1],
        single[::1],
        whole[::1],
        real[::1],
        whole[::1],
        single[:, ::1],
        real[:, :, ::1],
        whole[::1],
        real[::1],
    )
    text, _ = compile_ptx(cuda.cuda_kernel(structure).run.py_func, signature, cc=(9, 0))
    assert ".target sm_90" in text and ".visible .entry" in text
    assert "fma.rn.f64" in text


def test_the_text_for_a_gpu_makes_no_arrays_and_is_that_of_one_lane():
    for method in ("series", "split"):
        for vehicle in (cuda_cases.PHILAE, cuda_cases.WHEELLESS):
            text = cuda.cuda_source(k.structure_of(vehicle, None, 8, method))
            assert "\nLANES = 1\n" in text
            for word in ("np.empty", "np.zeros", "njit", "[:] ="):
                assert word not in text


def test_a_driver_that_has_changed_is_noticed(monkeypatch):
    monkeypatch.setattr(cuda, "SUBSTITUTIONS", ((r"^no such line$", ""),))
    with pytest.raises(RuntimeError, match="nothing like"):
        cuda.cuda_source(k.structure_of(cuda_cases.PHILAE, None, 0))


def test_the_processors_text_does_not_know_of_gpus():
    text = compiled.source(k.structure_of(cuda_cases.PHILAE, None, 8))
    assert "cuda" not in text and "\nLANES = 16\n" in text


def run_on(device):
    vehicle, rows, duration, options = cuda_cases.CASES["no wheel"]
    return k.run_rows(vehicle, rows, duration, device=device, **options)


def test_without_numba_cuda_the_refusal_says_what_to_install(monkeypatch):
    monkeypatch.setattr(cuda.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        ss.InputError,
        match=r'needs numba-cuda, which is not installed.*pip install "sunspin\[gpu\]"',
    ):
        run_on("cuda")


@needs_numba_cuda
def test_without_a_gpu_the_refusal_says_so(monkeypatch):
    monkeypatch.setattr(cuda, "_is_available", lambda: False)
    with pytest.raises(ss.InputError, match='needs an NVIDIA GPU.*use device "cpu"'):
        run_on("cuda")


def test_other_devices_are_refused():
    with pytest.raises(ss.InputError, match='must be "cpu" or "cuda"'):
        run_on("tpu")
    start = Start.on_grid(PHILAE, [np.zeros(1)] * 3, [0, 0, 1], 0.0)
    with pytest.raises(ss.InputError, match='must be "cpu" or "cuda"'):
        EmdRows(PHILAE, start, [0.5], None, 10.0, device="gpu")
    with pytest.raises(ss.InputError, match='must be "cpu" or "cuda"'):
        TrackRows(PHILAE, start, np.array([[0.0, 0.0, 1.0]]), np.array([1.0]), device="gpu")


@pytest.mark.long
def test_the_command_line_refuses_in_one_sentence_before_it_writes_anything(tmp_path):
    subprocess.run(
        [sys.executable, "-m", "sunspin.cli", "init", tmp_path / "mine"],
        check=True,
        capture_output=True,
    )
    grid = [part for axis in "xyz" for part in (f"--omega-{axis}", "0.1,0.2")]
    options = [*grid, "--device", "cuda", "--store", "rows"]
    done = subprocess.run(
        [sys.executable, "-m", "sunspin.cli", "scan", "vehicle.toml", "telemetry.csv", *options],
        cwd=tmp_path / "mine",
        env=os.environ | {"CUDA_VISIBLE_DEVICES": "-1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2, done.stderr
    assert (
        'pip install "sunspin[gpu]"' in done.stderr and len(done.stderr.strip().splitlines()) == 1
    )
    assert not (tmp_path / "mine" / "rows").exists()


def test_the_identity_of_rows_tells_the_device():
    start = Start.on_grid(PHILAE, [np.zeros(1)] * 3, [0, 0, 1], 0.0)
    emd = [
        EmdRows(PHILAE, start, [0.5], None, 10.0, device=device).identity()
        for device in ("cpu", "cuda")
    ]
    assert [identity["device"] for identity in emd] == ["cpu", "cuda"]
    measured = np.array([[0.0, 0.0, 1.0]])
    track = [
        TrackRows(PHILAE, start, measured, np.array([1.0]), device=device).identity()
        for device in ("cpu", "cuda")
    ]
    assert track[0] != track[1]
