"""Laws of a listening file: it holds the acceleration under every finger, all on one scale."""

import wave
from math import inf
from pathlib import Path

import numpy as np
import pytest

from base.arrays import Array
from precompute.clicks.click_basis import RINGDOWN_S
from tactable.explain.click_sound import (
    LOUDEST,
    PAUSE_S,
    SOUND_RATE_HZ,
    compute_felt,
    make_sound,
    sound_json,
    write_sound,
)
from tactable.explain.click_source import ClickSource
from tests.tactable.click_table import click_of


def peaks(course: Array) -> list[float]:
    values: list[float] = abs(course).max(axis=0).tolist()
    return values


@pytest.mark.parametrize("level_db", [inf, 1.0])
def test_what_is_heard_has_the_peaks_of_the_table(source: ClickSource, level_db: float) -> None:
    """The table lacks what the corners between samples make: 0.5 % where a finger feels, 2 % where little moves."""
    click = click_of(source, "I", "III", level_db)
    promised, at_m = click.fingers, click.placement.position_m
    plain, weighted = (compute_felt(source.table.device, click, at_m, is_weighted=choice) for choice in (False, True))
    assert peaks(plain) == pytest.approx([zone.acceleration_at_finger_m_per_s2 for zone in promised], rel=0.03)
    assert peaks(plain)[0] == pytest.approx(promised[0].acceleration_at_finger_m_per_s2, rel=5e-3)
    assert 20 * np.log10(peaks(weighted)) == pytest.approx([zone.level_db for zone in promised], abs=0.05)


@pytest.mark.parametrize("is_weighted", [True, False])
def test_fingers_come_one_after_another_felt_ones_first_on_one_scale(source: ClickSource, is_weighted: bool) -> None:
    click = click_of(source, "III", "I")
    heard = compute_felt(source.table.device, click, click.placement.position_m, is_weighted=is_weighted)
    sound = make_sound(source.table.device, click, click.placement, is_weighted=is_weighted, is_stereo=False)
    assert sound.order == ("232.8 mm (III)", "46.57 mm (I)")
    assert sound.samples.shape == (2 * round((click.length_s + RINGDOWN_S + PAUSE_S) * SOUND_RATE_HZ), 1)
    felt, quiet = sound.samples[:, 0].reshape(2, -1)[:, : len(heard)]
    scaled = heard * (LOUDEST / sound.loudest_value)
    assert felt == pytest.approx(scaled[:, 1], abs=0.51)
    assert quiet == pytest.approx(scaled[:, 0], abs=0.51)
    assert abs(sound.samples).max() == round(LOUDEST)
    assert not sound.samples[:, 0].reshape(2, -1)[:, len(heard) :].any()


def test_stereo_is_the_felt_finger_left_and_the_quiet_one_right(source: ClickSource) -> None:
    click = click_of(source, "III", "I")
    one_by_one, beside = (
        make_sound(source.table.device, click, click.placement, is_weighted=True, is_stereo=choice)
        for choice in (False, True)
    )
    halves = one_by_one.samples[:, 0].reshape(2, -1)[:, : len(beside.samples)]
    assert (beside.samples == halves.T).all()
    assert "felt left, quiet right" in beside.words


@pytest.mark.parametrize("is_stereo", [True, False])
def test_a_file_holds_the_samples(source: ClickSource, tmp_path: Path, is_stereo: bool) -> None:
    click = click_of(source, "I", "III")
    sound = make_sound(source.table.device, click, click.placement, is_weighted=False, is_stereo=is_stereo)
    write_sound(sound, tmp_path / "click.wav")
    with wave.open(str(tmp_path / "click.wav"), "rb") as file:
        assert (file.getnchannels(), file.getsampwidth(), file.getframerate()) == (1 + is_stereo, 2, SOUND_RATE_HZ)
        read = np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, 1 + is_stereo)
    assert (read == sound.samples).all()
    assert sound_json(sound)["channels"] == 1 + is_stereo
