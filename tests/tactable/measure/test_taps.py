"""Laws of taps: a tapped model gives back its responses, modes and shapes; what spoils a tap is named with a remedy."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from base.arrays import Array
from precompute.measurements.measured_modes import parse_modes
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.model import MeasurementModel
from precompute.model.modal import compute_modes
from tactable.measure.sensor import ACCELERATION, REFERENCE, SensorError, SensorForm, write_header
from tactable.measure.simulated_bench import ConverterFlaws
from tactable.measure.tapping.hammer import RATE_HZ, HammerOptions, TapBench, Tapped, responses_text
from tactable.measure.tapping.taps import Tap, TapFault, find_taps, response_of
from tests.precompute.devices import shipped
from tests.tactable.cli.in_process import run_here

DEVICE = shipped("reference-a")
QUIET = ConverterFlaws(noise_m_per_s2=0.02)
HZ = np.arange(60.0, 301.0)
SENSOR_M, TAPPED_M = 0.025, 0.12
ALONE = SensorForm(RATE_HZ, (ACCELERATION,), (np.inf,))
TIMES_S = (0.2, 3.7)


def bench(flaws: ConverterFlaws = QUIET, sensor_m: float = SENSOR_M, seed: int = 1) -> TapBench:
    return TapBench(DEVICE, flaws, seed, sensor_m, 0.0)


def tapped(form: SensorForm, places_m: tuple[float, ...], taps: tuple[tuple[Tap, ...], ...]) -> Tapped:
    return Tapped(HammerOptions(places_m, SENSOR_M, len(taps[0]), 3.5, 0.0), form, taps)


def in_band() -> tuple[Array, Array]:
    modes = [mode for mode in compute_modes(DEVICE, np.array([0.1]), 300) if mode.frequency_hz > 60]
    return tuple(np.array([getattr(mode, key) for mode in modes]) for key in ("frequency_hz", "damping_ratio"))  # type: ignore[return-value]


def test_responses_per_newton_are_the_models_and_are_read_back(tmp_path: Path) -> None:
    found, error = tapped(
        bench().form, (TAPPED_M,), (tuple(find_taps(bench().record(TAPPED_M, TIMES_S, 7.2), bench().form)),)
    ).responses(DEVICE, HZ)
    (tmp_path / "r.csv").write_text(responses_text(found, DEVICE, "SIMULATED taps"), encoding="utf-8")
    read = read_measurements(tmp_path / "r.csv", DEVICE)
    np.testing.assert_allclose(read.acceleration, found.acceleration, rtol=1e-5)
    assert read.is_simulated and read.force_m is not None and set(read.force_m) == {TAPPED_M}
    true = np.exp(MeasurementModel(DEVICE, read, ()).predict(np.zeros(0)).log_acceleration)
    off = abs(read.acceleration / true - 1)
    assert np.median(off) < 3e-3 and np.percentile(off, 90) < 0.02
    assert (off < 6 * error + 0.01).mean() > 0.9


@pytest.mark.parametrize(("channels", "of_frequency", "of_damping"), [(2, 2e-4, 0.02), (1, 2e-3, 0.05)])
def test_modes_are_found_with_a_force_channel_and_without(
    channels: int, of_frequency: float, of_damping: float
) -> None:
    form = bench().form if channels == 2 else ALONE
    places_m = (TAPPED_M, 0.01, 0.27)
    taps = tuple(tuple(find_taps(bench().record(at, TIMES_S, 7.2)[:, :channels], form)) for at in places_m)
    assert all(not tap.faults for each in taps for tap in each)
    modes = parse_modes(tapped(form, places_m, taps).modes(DEVICE, HZ, "taps"), DEVICE, 0.0, "taps")
    true_hz, true_damping = in_band()
    np.testing.assert_allclose(modes.frequency_hz, true_hz, rtol=of_frequency)
    np.testing.assert_allclose(modes.damping_ratio, true_damping, rtol=of_damping)
    assert len(modes.place_m) == (3 if channels == 2 else 0)


def test_a_reference_tells_the_shapes_whatever_the_taps_were() -> None:
    """The sensor roves; each of its records has another tap beside it."""
    form = SensorForm(RATE_HZ, (ACCELERATION, REFERENCE), (np.inf, np.inf))
    places_m, taps = (0.01, 0.08, 0.15, 0.22, 0.27), []
    for seed, place_m in enumerate(places_m):
        pair = [bench(sensor_m=at, seed=seed).record(TAPPED_M, TIMES_S[:1], 4.0)[:, 0] for at in (place_m, SENSOR_M)]
        taps.append(tuple(find_taps(np.stack(pair, axis=1), form)))
    modes = parse_modes(tapped(form, places_m, tuple(taps)).modes(DEVICE, HZ, "taps"), DEVICE, 0.0, "taps")
    true = [mode for mode in compute_modes(DEVICE, np.array(places_m), 300) if mode.frequency_hz > 60]
    for shape, mode in zip(modes.shape, true, strict=True):
        assurance = (
            abs(np.vdot(shape, mode.shape)) ** 2 / (np.vdot(shape, shape) * np.vdot(mode.shape, mode.shape)).real
        )
        assert assurance > 0.96  # dampers at two places make modes complex; a file of shapes has their real parts


@pytest.mark.parametrize("later_s", [0.004, 0.02, 0.1, 0.25])
def test_a_double_hit_is_named(later_s: float) -> None:
    twice = bench().record(TAPPED_M, (0.2, 0.2 + later_s), 4.0)
    assert [tap.faults for tap in find_taps(twice, bench().form)] == [(TapFault.DOUBLE,)]
    if later_s >= 0.1:  # without a force channel the second one must stand out of the ringing
        assert [tap.faults for tap in find_taps(twice[:, :1], ALONE)] == [(TapFault.DOUBLE,)]


def test_clipping_lost_samples_and_a_cut_decay_are_named_with_what_to_do() -> None:
    whole = bench().record(TAPPED_M, TIMES_S, 7.2)
    half = abs(whole[:, 0]).max() / 2
    flat = np.clip(whole, -half, half)
    assert {tap.faults for tap in find_taps(flat, bench().form)} <= {(TapFault.CLIPPED,), ()}
    assert any(tap.faults for tap in find_taps(flat, bench().form))
    declared = SensorForm(RATE_HZ, bench().form.channels, (half, np.inf))
    assert TapFault.CLIPPED in find_taps(whole, declared)[0].faults + find_taps(whole, declared)[1].faults
    lost = whole.copy()
    lost[round(0.5 * RATE_HZ), 0] = np.nan
    assert [tap.faults for tap in find_taps(lost, bench().form)] == [(TapFault.LOST,), ()]
    (cut,) = find_taps(whole[: round(0.9 * RATE_HZ)], bench().form)
    assert cut.faults == (TapFault.SHORT,)
    assert "wait longer between taps, " in cut.text and 0.7 < cut.needed_s < 4
    hum = ConverterFlaws(noise_m_per_s2=0.02, hum_m_per_s2=0.5, offset_m_per_s2=9.81)  # which spoil no tap
    assert all(not tap.faults for tap in find_taps(bench(hum).record(TAPPED_M, TIMES_S, 7.2), bench().form))


def test_silence_and_a_soft_tip_are_refused() -> None:
    for dead in (np.full((2400, 2), np.nan), np.full((2400, 2), np.inf), np.zeros((0, 2))):
        with pytest.raises(SensorError, match="a channel has no sample: check its connection"):
            find_taps(dead, bench().form)
    with pytest.raises(SensorError, match="no tap stands out of the noise: tap harder"):
        find_taps(bench().record(TAPPED_M, (), 2.0)[:, :1], ALONE)
    taps = find_taps(bench().record(TAPPED_M, TIMES_S, 7.2), bench().form)
    with pytest.raises(SensorError, match=r"little force from \d+ Hz on: take a harder tip"):
        response_of(taps, bench().form, np.arange(60.0, 3000.0, 20.0))


def test_the_command_reads_samples_and_a_wav_file_and_refuses_what_does_not_fit(tmp_path: Path) -> None:
    places_m = (0.02 * 0.2794, 0.98 * 0.2794)
    values = np.concatenate([bench().record(at, TIMES_S, 7.2) for at in places_m])
    raw = write_header(bench().form) + values.astype("<f4").tobytes()
    (tmp_path / "taps.samples").write_bytes(raw)
    wavfile.write(tmp_path / "taps.wav", round(RATE_HZ), (values / [2000, 2] * 2**31).astype(np.int32))
    words = ("--hammer", "at=25mm,taps=2", "--places", "2", "--sensor-mass", "0 g")
    wav = "audio:taps.wav,acceleration=1,scale=2000 m/s^2,force=2,force_scale=2 N"
    for name, sensor in (("a.csv", "taps.samples"), ("b.csv", wav)):
        done = run_here(tmp_path, "measure", "reference-a", "-o", name, "--sensor", sensor, *words)
        assert done.returncode == 0, done.stderr
        assert "4 good taps at 2 places" in done.stdout
    one, other = (read_measurements(tmp_path / name, DEVICE) for name in ("a.csv", "b.csv"))
    np.testing.assert_allclose(one.acceleration, other.acceleration, rtol=1e-3)
    short = wav.partition(",force")[0]
    for sensor, more, part in (
        (
            wav,
            ("--hammer", "at=25mm,taps=3"),
            "has 4 taps, at 0.20, 3.70, 7.40, 10.90 s; expected 6: 3 at each of 2 places",
        ),
        (wav.replace("force=2", "force=3"), (), "has 2 channels, and the text names channel 3"),
        (short + ",force=2", (), "force_scale is missing"),
        (short, ("--modes", "m.csv"), "leave it out"),
        (wav, ("--port", "simulated"), "drives nothing"),
        (wav, ("--hammer", "at=30 s"), "--hammer: at: "),
        (wav, ("--hammer", "taps=3"), "--hammer 'taps=3': "),
        (wav, ("--hammer", "at=25mm,taps=0"), "1 to 100 taps"),
        (wav, ("--frequencies", "100"), "a range such as"),
    ):
        done = run_here(tmp_path, "measure", "reference-a", "-o", "c.csv", "--sensor", sensor, *words, *more)
        assert done.returncode == 1 and part in done.stderr, done.stderr
        assert not (tmp_path / "c.csv").exists()
    done = run_here(tmp_path, "measure", "reference-a", "-o", "modes.csv", "--sensor", short, *words)
    assert done.returncode == 0 and "no shapes" in done.stdout, done.stderr
    done = run_here(tmp_path, "measure", "reference-a", "-o", "d.csv", "--sensor", "simulated")
    assert done.returncode == 1 and "--port is missing" in done.stderr
    done = run_here(tmp_path, "measure", "reference-a", "-o", "d.csv", "--sensor", "simulated", "--modes", "m.csv")
    assert done.returncode == 1 and "give --hammer too" in done.stderr
