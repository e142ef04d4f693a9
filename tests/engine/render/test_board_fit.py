"""Laws of a table on a board of another full scale: displacements are the table's, or the board is refused."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device, Electrodes
from engine.effects.rules import DEFAULT_EFFECTS
from engine.loop.fast.fast_layout import with_fast_table
from engine.render.board_fit import NO_BASIS, RendererError, choose_basis, fit_board
from engine.render.prepared import Rendering, render_table
from engine.render.renderer import DriveCommand, PlayCommand
from engine.table import Table
from firmware_link.host.link_values import BOARD_SOUND_CARD, Capabilities
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, BasisSet, clamp_samples, sample_limits, weighted_sum
from firmware_link.protocol.drive_words import decode_drive
from firmware_link.protocol.messages import LINEARISES, Features, Play, decode_body, encode_play_body
from tests.engine.made_table import LEVEL_DB, click_of, in_zones, write_table
from tests.engine.render.made_steady import board
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
TABLE_M = REFERENCE.actuators[0].full_scale_m
PLACEMENT = in_zones(REFERENCE, [0])


def limited_to(amplitude: float) -> Device:
    """As a file says it: a table carries the text of its device."""
    text = REFERENCE.text.replace('amplitude = "100 %"', f'amplitude = "{100 * amplitude:g} %"')
    device = Device.parse(text, "limited")
    assert device.limits.amplitude == amplitude
    return device


@pytest.fixture(scope="module", params=[1.0, 0.4], ids=["limit 100 %", "limit 40 %"])
def table(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Table:
    """One click that uses both functions of its basis."""
    device = limited_to(request.param)
    wave = np.rint(20_000 * np.sin(np.linspace(0, 4 * np.pi, 121))).astype(np.int16)
    wave[[0, -1]] = 0
    basis = Basis(4000, (BasisSet(np.stack([wave, -wave // 3]), np.arange(2, dtype=np.uint8)),))
    made = click_of(device, PLACEMENT, level_db=LEVEL_DB)
    click = replace(made, basis=basis, weights=np.array([9_000, -8_000], np.int16), fraction_bits=14)
    path = tmp_path_factory.mktemp("fit") / "bar.nc"
    return Table.open(write_table(path, device, [click]))


def steady_m(rendering: Rendering, full_scales_m: Sequence[float]) -> list[float]:
    command = rendering.renderer.render(PLACEMENT, 60.0)
    assert isinstance(command, DriveCommand)
    return [c.amplitude * full_m for c, full_m in zip(decode_drive(command.drive, 0.01), full_scales_m, strict=False)]


def click_m(rendering: Rendering, full_scales_m: Sequence[float]) -> Array:
    """Displacements (sample, actuator) of the click, made as the firmware makes them."""
    command, configuration = rendering.renderer.render(PLACEMENT, LEVEL_DB, is_click=True), rendering.configuration
    assert isinstance(command, PlayCommand) and configuration.basis is not None
    _, play = decode_body(encode_play_body(1, command.click.play, 2))
    assert isinstance(play, Play)
    number = configuration.number_of_actuators
    sums = weighted_sum(configuration.basis.sets[play.basis_set], play.weights, play.fraction_bits, number)
    words = configuration.arm_for(1, number, 40).amplitude_limits
    samples = clamp_samples(sums, sample_limits(words, 655_350_000, configuration.basis.sample_rate_hz))
    moved: Array = samples * (play.amplitude / 65_535 / SAMPLE_FULL_SCALE) * np.array(full_scales_m[:2])
    return moved


@pytest.mark.parametrize(
    "full_scales_m", [(2.6e-6, 2.6e-6), (0.9e-6, 2e-6), (0.3e-6, 0.3e-6), (0.22e-6, 0.6e-6), (2.6e-6, 2.6e-6, 1e-6)]
)
def test_drives_and_clicks_move_a_board_of_another_full_scale_as_the_table_says(
    table: Table, full_scales_m: tuple[float, ...]
) -> None:
    if min(full_scales_m) < TABLE_M * table.device.limits.amplitude:
        with pytest.raises(RendererError, match="too little for the table's amplitude limit of 100 %: connect"):
            render_table(table, DEFAULT_EFFECTS, board(*full_scales_m))
        return
    own = render_table(table, DEFAULT_EFFECTS, board(TABLE_M, TABLE_M))
    scaled = render_table(table, DEFAULT_EFFECTS, board(*full_scales_m))
    assert own.fit.notes == () and "amplitudes are multiplied by" in scaled.fit.notes[0]
    # A word of the wire is 1/65535 of full scale, a sample 1/32767; rounding a function of the basis moves some.
    assert steady_m(scaled, full_scales_m) == pytest.approx(steady_m(own, [TABLE_M] * 2), abs=2e-5 * max(full_scales_m))
    wanted_m = click_m(own, [TABLE_M] * 2)
    assert np.abs(wanted_m).max() > 0.1 * TABLE_M
    np.testing.assert_allclose(click_m(scaled, full_scales_m), wanted_m, rtol=0, atol=2e-4 * max(full_scales_m))


def test_the_compiled_step_plays_the_same_bytes(table: Table) -> None:
    capabilities = board(0.3e-6, 0.6e-6) if table.device.limits.amplitude < 0.5 else board(2.6e-6, 0.9e-6)
    rendering = with_fast_table(render_table(table, DEFAULT_EFFECTS, capabilities), capabilities)
    command = rendering.renderer.render(PLACEMENT, LEVEL_DB, is_click=True)
    assert isinstance(command, PlayCommand) and rendering.fast_table is not None
    _, play = decode_body(encode_play_body(1, command.click.play, 2))
    assert isinstance(play, Play)
    assert tuple(rendering.fast_table.head[0]) == (play.basis_set, play.fraction_bits, play.number_of_weights)


def test_the_firmware_gets_limits_of_the_same_displacement_and_time(table: Table) -> None:
    limit, factor = table.device.limits.amplitude, TABLE_M / 2.6e-6
    arm = render_table(table, DEFAULT_EFFECTS, board(2.6e-6, 2.6e-6)).configuration
    assert arm.amplitude_limits == pytest.approx((limit * factor,) * 2)
    assert arm.slew_limit_per_s == int(table.device.limits.slew_per_s * factor)


@pytest.mark.parametrize("factor", [0.92, 1.0, 1.09])
def test_what_a_calibration_finds_beside_a_nominal_full_scale_is_played_as_it_is(factor: float) -> None:
    fit = fit_board(REFERENCE, board(factor * TABLE_M, TABLE_M))
    assert (fit.scales, fit.notes) == ((1.0, 1.0), ())


def test_actuators_beyond_the_tables_and_a_shorter_lease_are_said() -> None:
    fit = fit_board(REFERENCE, board(TABLE_M, TABLE_M, 1e-9, longest_lease_ms=20))
    assert fit.scales == (1.0, 1.0)
    assert ["drives 1 more" in fit.notes[0], "allows leases of 20 ms" in fit.notes[1]] == [True, True]


def with_electrodes(linearised_by: str) -> Device:
    electrodes = Electrodes(1, 0.7, 180.0, linearised_by)  # type: ignore[arg-type]  # one of LINEARISERS
    return replace(REFERENCE, actuators=tuple(replace(each, electrodes=electrodes) for each in REFERENCE.actuators))


def test_the_square_of_the_voltage_is_undone_once_or_the_board_is_refused() -> None:
    straight = board(TABLE_M, TABLE_M)
    linearising = replace(straight, features=straight.features | LINEARISES)
    assert fit_board(with_electrodes("board"), linearising).scales == (1.0, 1.0)
    for by in ("amplifier", "nothing"):
        assert fit_board(with_electrodes(by), straight).scales == (1.0, 1.0)
        with pytest.raises(
            RendererError, match=f"left: electrodes.linearised_by is '{by}', and the .* 'board', or flash"
        ):
            fit_board(with_electrodes(by), linearising)
    with pytest.raises(
        RendererError, match=r"is 'board', and the connected board does not: flash electrode_bias = 45874"
    ):
        fit_board(with_electrodes("board"), straight)
    assert fit_board(REFERENCE, linearising).scales == (1.0, 1.0)  # the file does not say


def test_a_range_that_ends_half_a_step_before_the_band_plays_it() -> None:
    ends = board(TABLE_M, TABLE_M, frequency_minimum_hz=60.005, frequency_maximum_hz=299.995, synthesis_rate_hz=3000)
    assert fit_board(REFERENCE, ends).scales == (1.0, 1.0)


@pytest.mark.parametrize(
    ("capabilities", "names"),
    [
        *((board(TABLE_M, full_m), "right is 0.52 um in the table and .*: connect the") for full_m in (0.0, 0.03e-6)),
        *((board(TABLE_M, full_m), "right is 0.52 um in the table and .*: connect the") for full_m in (5.3e-6, 520e-6)),
        (board(TABLE_M), "reference-a has 2 actuators, .* 1: connect"),
        (board(TABLE_M, TABLE_M, synthesis_rate_hz=2999), "2999 samples a second; expected 10 a period"),
        (board(TABLE_M, TABLE_M, frequency_maximum_hz=299.0), "left .*60-300 Hz; .* 1-299 Hz: narrow"),
        (board(TABLE_M, TABLE_M, frequency_minimum_hz=61.0), "left .*60-300 Hz; .* 61-655.35 Hz: narrow"),
        (board(TABLE_M, TABLE_M, frequency_resolution_hz=0.0), "left .* 0 Hz apart, .*0.6 Hz: flash a finer"),
        (board(TABLE_M, TABLE_M, frequency_resolution_hz=1.0), "left .* 1 Hz apart, .*0.6 Hz: flash a finer"),
        (board(TABLE_M, 520e-6, board=BOARD_SOUND_CARD), r"give --port full_scale=0\.52 um"),
    ],
)
def test_a_board_that_cannot_play_a_table_is_refused_with_a_remedy(capabilities: Capabilities, names: str) -> None:
    with pytest.raises(RendererError, match=names):
        fit_board(REFERENCE, capabilities)


@pytest.mark.parametrize(
    ("capabilities", "factors", "remedy"),
    [
        (board(1.3 * TABLE_M, TABLE_M), "0.769, 1", "flash full_scales_pm = {520000, 520000}"),
        (board(9.9 * TABLE_M, TABLE_M), "0.101, 1", "flash full_scales_pm = {520000, 520000}"),
        (board(1.3 * TABLE_M, TABLE_M, board=BOARD_SOUND_CARD), "0.769, 1", "give --port full_scale=0.52 um+0.52 um"),
    ],
)
def test_scaling_is_said_with_its_factors_and_its_remedy(capabilities: Capabilities, factors: str, remedy: str) -> None:
    (note,) = fit_board(REFERENCE, capabilities).notes
    assert f"multiplied by {factors}" in note and note.endswith(remedy)


CAPABILITIES = board()
RATE_HZ, LEASE_MS = 115_200, 40


def whole(*shapes: tuple[int, int]) -> Basis:
    """A basis of sets with so many functions and samples."""
    sets = tuple(BasisSet(np.zeros(shape, np.int16), (np.arange(shape[0]) % 2).astype(np.uint8)) for shape in shapes)
    return Basis(4000, sets)


def test_a_basis_that_fits_is_held_as_it_is() -> None:
    basis = whole((44, 121), (80, 241))
    chosen = choose_basis(basis, CAPABILITIES, RATE_HZ, LEASE_MS)
    assert chosen.basis is basis
    assert chosen.sets == {0: 0, 1: 1}


@pytest.mark.parametrize(
    ("changed", "rate_hz"),
    [
        ({"longest_waveform_ms": 30}, RATE_HZ),
        ({"basis_capacity_bytes": 30_000}, RATE_HZ),
        ({}, 57_600),  # 44 weights take 18 ms, 80 take 31
    ],
)
def test_sets_that_do_not_fit_are_left_out_and_others_keep_their_order(changed: dict[str, int], rate_hz: int) -> None:
    basis = whole((80, 241), (44, 121), (40, 121))
    chosen = choose_basis(basis, replace(CAPABILITIES, **changed), rate_hz, LEASE_MS)  # type: ignore[arg-type]
    assert chosen.sets == {1: 0, 2: 1}
    assert chosen.basis is not None
    assert [len(each.actuators) for each in chosen.basis.sets] == [44, 40]


@pytest.mark.parametrize(
    ("changed", "rate_hz"),
    [
        ({"features": Features(0)}, RATE_HZ),
        ({"basis_capacity_bytes": 100}, RATE_HZ),
        ({"longest_waveform_ms": 20}, RATE_HZ),
        ({"synthesis_rate_hz": 3999}, RATE_HZ),
        ({}, 38_400),
    ],
)
def test_a_device_or_line_that_carries_no_click_gets_no_basis(changed: dict[str, int], rate_hz: int) -> None:
    basis = whole((44, 121))
    assert choose_basis(basis, replace(CAPABILITIES, **changed), rate_hz, LEASE_MS) == NO_BASIS  # type: ignore[arg-type]
    assert choose_basis(None, CAPABILITIES, RATE_HZ, LEASE_MS) == NO_BASIS
